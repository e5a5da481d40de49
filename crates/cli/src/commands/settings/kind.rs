//! What a setting is in TOML, told from what its option parses to.

use std::any::TypeId;
use std::ffi::OsStr;
use std::time::Duration;

use clap::Arg;
use toml::de::DeValue;

/// What a setting is written as in TOML.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Switch,
    Whole,
    Number,
    Text,
    /// Text that may be a number: of options that read their values by themselves.
    Any,
}

impl Kind {
    pub(super) fn of(setting: &Arg) -> Self {
        let parsed = setting.get_value_parser().type_id();
        let is = |types: &[TypeId]| types.iter().any(|one| parsed == *one);
        let wholes = [
            TypeId::of::<u8>(),
            TypeId::of::<u16>(),
            TypeId::of::<u32>(),
            TypeId::of::<u64>(),
            TypeId::of::<usize>(),
            TypeId::of::<i32>(),
            TypeId::of::<i64>(),
        ];
        // Durations are seconds.
        let numbers = [TypeId::of::<f32>(), TypeId::of::<f64>(), TypeId::of::<Duration>()];
        if is(&[TypeId::of::<bool>()]) {
            Self::Switch
        } else if is(&wholes) {
            Self::Whole
        } else if is(&numbers) {
            Self::Number
        } else {
            Self::Text
        }
    }

    /// The same of an option that is no setting of the server.
    pub(super) fn of_default(option: &Arg) -> Self {
        match Self::of(option) {
            Self::Text if option.get_possible_values().is_empty() => Self::Any,
            kind => kind,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Switch => "true or false",
            Self::Whole => "a whole number",
            Self::Number => "a number",
            Self::Text => "text in quotes",
            Self::Any => "text in quotes, or a number",
        }
    }

    /// The value as it would be typed, if it is of this kind.
    pub(super) fn typed(self, value: &DeValue<'_>) -> Option<String> {
        match (self, value) {
            (Self::Switch, DeValue::Boolean(on)) => Some(on.to_string()),
            (Self::Whole | Self::Number | Self::Any, DeValue::Integer(whole)) => {
                i128::from_str_radix(whole.as_str(), whole.radix()).ok().map(|whole| whole.to_string())
            }
            (Self::Number | Self::Any, DeValue::Float(number)) => Some(number.as_str().to_owned()),
            (Self::Text | Self::Any, DeValue::String(text)) => Some(text.to_string()),
            _ => None,
        }
    }

    /// A value that was typed, as TOML; text where it does not parse, which then is told as wrong.
    pub(super) fn toml(self, typed: &OsStr) -> String {
        let typed = typed.to_string_lossy();
        let bare = match self {
            Self::Switch => typed.parse::<bool>().map(|on| on.to_string()).ok(),
            Self::Whole => typed.parse::<i128>().map(|whole| whole.to_string()).ok(),
            Self::Number => typed.parse::<f64>().map(|number| number.to_string()).ok(),
            Self::Text | Self::Any => None,
        };
        bare.unwrap_or_else(|| toml::Value::from(typed.as_ref()).to_string())
    }
}
