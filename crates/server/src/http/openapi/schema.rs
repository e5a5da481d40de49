//! The description's schemas against values: as much of JSON Schema as it uses. Stricter in one way: an object has no
//! member that its schema leaves out.

use humantime::parse_rfc3339;
use serde_json::Value;

/// Why a value is not what a schema says.
type Wrong = String;

/// Holds a value against a schema of the description.
///
/// # Panics
/// On a keyword that is not known here.
pub(super) fn check(description: &Value, schema: &Value, value: &Value) -> Result<(), Wrong> {
    let schema = resolved(description, schema);
    for (keyword, wanted) in schema.as_object().expect("a schema") {
        let holds = match keyword.as_str() {
            // Words; and what holds of texts alone, of which the interoperability tests know more.
            "description" | "default" | "contentMediaType" | "pattern" => true,
            "type" => is_of(wanted, value),
            "const" => value == wanted,
            "enum" => wanted.as_array().expect("a list").contains(value),
            "format" => {
                wanted == "date-time" && value.as_str().is_some_and(|text| parse_rfc3339(text).is_ok())
            }
            "minimum" => value.as_f64() >= wanted.as_f64(),
            "maximum" => value.as_f64() <= wanted.as_f64(),
            "exclusiveMinimum" => value.as_f64() > wanted.as_f64(),
            "minItems" => value.as_array().map(Vec::len) >= wanted.as_u64().map(|n| n as usize),
            "maxItems" => value.as_array().map(Vec::len) <= wanted.as_u64().map(|n| n as usize),
            "required" => {
                wanted.as_array().expect("names").iter().all(|name| value.get(text(name)).is_some())
            }
            "properties" => {
                for (name, member) in value.as_object().ok_or("not an object")? {
                    let schema = wanted.get(name).ok_or_else(|| format!("{name} is not described"))?;
                    check(description, schema, member).map_err(|why| format!("{name}: {why}"))?;
                }
                true
            }
            "additionalProperties" => wanted == false,
            "items" => {
                for item in value.as_array().ok_or("not a list")? {
                    check(description, wanted, item)?;
                }
                true
            }
            "prefixItems" => {
                for (schema, item) in
                    wanted.as_array().expect("a list").iter().zip(value.as_array().ok_or("no list")?)
                {
                    check(description, schema, item)?;
                }
                true
            }
            other => panic!("{other} is not known here"),
        };
        if !holds {
            return Err(format!("{value} is not {keyword} {wanted}"));
        }
    }
    Ok(())
}

/// Holds what is read against the schema of a parameter: a bound from both sides, and a value of each kind.
pub(super) fn check_reader(schema: &Value, reads: impl Fn(&str) -> bool) -> Result<(), Wrong> {
    let mut found = Vec::new();
    for (keyword, value) in schema.as_object().expect("a schema") {
        let number = value.as_u64().map(i128::from);
        let near = |by| number.expect("a whole number").checked_add(by).expect("a number").to_string();
        let length = |by: i64| "x".repeat((value.as_i64().expect("a length") + by) as usize);
        // What is read, and what is not.
        let (good, bad): (Vec<String>, Vec<String>) = match keyword.as_str() {
            "description" | "default" => continue,
            "minimum" => (vec![near(0)], vec![near(-1)]),
            "maximum" => (vec![near(0)], vec![near(1)]),
            "exclusiveMinimum" => (vec![format!("{}.001", near(0))], vec![near(0), near(-1)]),
            "minLength" => (vec![length(0)], vec![length(-1)]),
            "maxLength" => (vec![length(0)], vec![length(1)]),
            "enum" => (
                value.as_array().expect("a list").iter().map(|one| text(one).to_owned()).collect(),
                vec!["?".into()],
            ),
            "pattern" => (Vec::new(), vec!["?".into()]),
            "type" => match text(value) {
                "integer" => (Vec::new(), vec!["1.5".into(), "?".into()]),
                "number" => {
                    let least = schema["minimum"].as_u64().or(schema["exclusiveMinimum"].as_u64());
                    (vec![format!("{}.5", least.unwrap_or(0))], vec!["?".into(), "nan".into()])
                }
                "boolean" => (vec!["true".into(), "false".into()], vec!["?".into()]),
                _ => continue,
            },
            other => panic!("{other} is not known here"),
        };
        found.extend(
            good.iter().filter(|text| !reads(text)).map(|text| format!("{keyword}: {text} is not read")),
        );
        found.extend(bad.iter().filter(|text| reads(text)).map(|text| format!("{keyword}: {text} is read")));
    }
    if found.is_empty() { Ok(()) } else { Err(found.join("; ")) }
}

/// A part of the description, or the one that it refers to.
pub(super) fn resolved<'a>(description: &'a Value, part: &'a Value) -> &'a Value {
    let Some(reference) = part["$ref"].as_str() else { return part };
    let pointer = reference.strip_prefix('#').expect("within the description");
    resolved(description, description.pointer(pointer).expect("somewhere"))
}

fn is_of(kinds: &Value, value: &Value) -> bool {
    let is = |kind: &str| match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        "null" => value.is_null(),
        other => panic!("{other} is not known here"),
    };
    match kinds {
        Value::Array(kinds) => kinds.iter().map(text).any(is),
        kind => is(text(kind)),
    }
}

fn text(value: &Value) -> &str {
    value.as_str().expect("text")
}

#[test]
fn what_is_not_as_described_is_noticed() {
    let schema = serde_json::json!({
        "type": "object", "required": ["count"], "additionalProperties": false,
        "properties": { "count": { "type": "integer", "minimum": 1 }, "at": { "type": "string", "format": "date-time" } },
    });
    let check = |value| check(&Value::Null, &schema, &value);
    assert_eq!(check(serde_json::json!({ "count": 1, "at": "2026-11-23T00:00:00.123Z" })), Ok(()));
    for wrong in [
        serde_json::json!({}),
        serde_json::json!([]),
        serde_json::json!({ "count": 0 }),
        serde_json::json!({ "count": 1.5 }),
        serde_json::json!({ "count": 1, "at": "yesterday" }),
        serde_json::json!({ "count": 1, "more": 2 }),
    ] {
        assert!(check(wrong.clone()).is_err(), "{wrong}");
    }
    let within = |least: u64, most: u64| {
        move |text: &str| text.parse().is_ok_and(|n: u64| (least..=most).contains(&n))
    };
    let schema = serde_json::json!({ "type": "integer", "minimum": 1, "maximum": 9 });
    assert_eq!(check_reader(&schema, within(1, 9)), Ok(()));
    assert!(check_reader(&schema, within(0, 9)).is_err() && check_reader(&schema, within(2, 9)).is_err());
    assert!(check_reader(&schema, within(1, 8)).is_err() && check_reader(&schema, within(1, 10)).is_err());
}
