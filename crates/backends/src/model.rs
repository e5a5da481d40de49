//! A trained cascade as files: a card and one ONNX file a unit.

use std::borrow::Cow;
use std::path::Path;

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::{BackendError, UnitShape};

/// A cascade's files in memory, checked against the card's hashes.
#[derive(Debug, Clone)]
pub struct Model {
    /// The card.
    pub card: Card,
    /// One ONNX file a unit.
    pub units: Vec<Cow<'static, [u8]>>,
    /// SHA-256 over all unit files in order, in hexadecimal: names the weights.
    pub sha256: String,
}

/// `model.toml`: what the cascade is. Fields that only people read are ignored here.
#[derive(Debug, Clone, Deserialize)]
pub struct Card {
    /// The model's name.
    pub name: String,
    /// Points in a patch (N).
    pub patch_size: usize,
    /// Edge neighbours (K).
    pub neighbours: usize,
    /// Feature channels (C).
    pub channels: usize,
    /// Trained parameters of all units together.
    pub parameters: u64,
    /// The units in the order of their levels.
    pub units: Vec<UnitFile>,
}

/// One unit's file.
#[derive(Debug, Clone, Deserialize)]
pub struct UnitFile {
    /// File name inside the model folder.
    pub file: String,
    /// SHA-256 of the file in hexadecimal.
    pub sha256: String,
}

/// Which model made a result.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ModelName {
    /// Name on the card.
    pub name: String,
    /// SHA-256 of the weights, in hexadecimal.
    pub sha256: String,
}

const CARD: &str = "model.toml";

impl Model {
    /// The model inside the program.
    ///
    /// # Errors
    /// [`BackendError::Model`] if the program was built with files that do not match their card.
    pub fn embedded() -> Result<Self, BackendError> {
        macro_rules! unit {
            ($file:literal) => {
                Cow::Borrowed(&include_bytes!(concat!("../../../models/default/", $file))[..])
            };
        }
        let units = vec![unit!("unit1.onnx"), unit!("unit2.onnx"), unit!("unit3.onnx"), unit!("unit4.onnx")];
        Self::check("default", include_str!("../../../models/default/model.toml"), units)
    }

    /// Reads a model folder.
    ///
    /// # Errors
    /// [`BackendError::Model`] naming the file that is missing, damaged or malformed.
    pub fn load(folder: &Path) -> Result<Self, BackendError> {
        let name = folder.display().to_string();
        let fail = |file: &str, why: &dyn std::fmt::Display| BackendError::Model {
            model: name.clone(),
            why: format!("{file}: {why}"),
        };
        let card = std::fs::read_to_string(folder.join(CARD)).map_err(|e| fail(CARD, &e))?;
        let parsed: Card = toml::from_str(&card).map_err(|e| fail(CARD, &e))?;
        let mut units = Vec::new();
        for unit in &parsed.units {
            // A card must not reach outside its folder.
            if Path::new(&unit.file).components().count() != 1 {
                return Err(fail(CARD, &format!("{:?} is not a plain file name", unit.file)));
            }
            let bytes = std::fs::read(folder.join(&unit.file)).map_err(|e| fail(&unit.file, &e))?;
            units.push(Cow::Owned(bytes));
        }
        Self::check(&name, &card, units)
    }

    fn check(name: &str, card: &str, units: Vec<Cow<'static, [u8]>>) -> Result<Self, BackendError> {
        let fail = |why: String| BackendError::Model { model: name.to_owned(), why };
        let card: Card = toml::from_str(card).map_err(|e| fail(format!("{CARD}: {e}")))?;
        if card.units.is_empty() || card.units.len() != units.len() {
            return Err(fail(format!("{CARD} names {} units, {} found", card.units.len(), units.len())));
        }
        if card.neighbours == 0 || card.patch_size <= card.neighbours || card.channels == 0 {
            return Err(fail(format!("{CARD}: patch_size must exceed neighbours, channels must not be 0")));
        }
        let mut all = Sha256::new();
        for (unit, bytes) in card.units.iter().zip(&units) {
            let found = hex::encode(Sha256::digest(bytes));
            if found != unit.sha256 {
                return Err(fail(format!(
                    "{} is damaged: its SHA-256 is {found}, the card says {}",
                    unit.file, unit.sha256
                )));
            }
            all.update(bytes);
        }
        Ok(Self { card, units, sha256: hex::encode(all.finalize()) })
    }

    /// How it is named where results tell what made them.
    #[must_use]
    pub fn name(&self) -> ModelName {
        ModelName { name: self.card.name.clone(), sha256: self.sha256.clone() }
    }

    /// The sizes that its units share.
    #[must_use]
    pub fn shape(&self) -> UnitShape {
        UnitShape {
            patch_size: self.card.patch_size,
            neighbours: self.card.neighbours,
            channels: self.card.channels,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder_of(model: &Model, spoil: impl Fn(&str, &mut Vec<u8>)) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let mut card = include_bytes!("../../../models/default/model.toml").to_vec();
        spoil(CARD, &mut card);
        std::fs::write(folder.path().join(CARD), card).unwrap();
        for (unit, bytes) in model.card.units.iter().zip(&model.units) {
            let mut bytes = bytes.to_vec();
            spoil(&unit.file, &mut bytes);
            std::fs::write(folder.path().join(&unit.file), bytes).unwrap();
        }
        folder
    }

    #[test]
    fn the_embedded_model_has_the_papers_parameters() {
        let model = Model::embedded().unwrap();
        assert_eq!(model.card.parameters, 304_108);
        assert_eq!(model.shape(), UnitShape { patch_size: 312, neighbours: 16, channels: 264 });
        assert_eq!(model.units.len(), 4);
    }

    #[test]
    fn a_folder_loads_like_the_embedded_model() {
        let model = Model::embedded().unwrap();
        let folder = folder_of(&model, |_, _| ());
        assert_eq!(Model::load(folder.path()).unwrap().sha256, model.sha256);
    }

    #[test]
    fn damage_is_found_and_named() {
        let model = Model::embedded().unwrap();
        let folder = folder_of(&model, |file, bytes| {
            if file == "unit2.onnx" {
                bytes[1000] ^= 1;
            }
        });
        let error = Model::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("unit2.onnx is damaged"), "{error}");

        std::fs::remove_file(folder.path().join("unit3.onnx")).unwrap();
        let error = Model::load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("unit3.onnx"), "{error}");

        let error = Model::load(&folder.path().join("nowhere")).unwrap_err().to_string();
        assert!(error.contains(CARD), "{error}");
    }
}
