//! What weights were trained on, and under which licences.

use crate::SyntheticError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Where a mesh or picture comes from. Folders tell it in `meta.json`: by object id or file name, an object with `name`, `source`,
/// `licence` and `ship`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The object's name or the picture's file name.
    pub name: String,
    /// Who made it.
    pub source: String,
    /// The licence as stated there.
    pub licence: String,
    /// Whether what is made from it may be shipped: yes, no, or what else is stated.
    pub ship: Ship,
}

/// Whether something may be shipped.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Ship {
    /// Stated as yes or no.
    Stated(bool),
    /// Not known, and why.
    Unclear(String),
}

/// What a training saw; it stands beside the weights (`.card.json`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Card {
    /// Whether all of it is stated to be shippable.
    pub may_ship: bool,
    /// How many different procedural shapes, made by this program, were used beside the meshes.
    pub procedural_shapes: usize,
    /// The meshes, those kept out for measuring not among them.
    pub objects: Vec<Origin>,
    /// The pictures for backgrounds.
    pub pictures: Vec<Origin>,
}

#[derive(Deserialize)]
struct Meta {
    name: Option<String>,
    source: Option<String>,
    licence: Option<String>,
    ship: Option<Ship>,
}

/// The statements of a folder.
pub(super) struct Statements(BTreeMap<String, Meta>);

impl Statements {
    /// Reads `meta.json`; without one nothing is stated.
    ///
    /// # Errors
    /// When it is there and cannot be read.
    pub(super) fn of_folder(folder: &Path) -> Result<Self, SyntheticError> {
        let path = folder.join("meta.json");
        if !path.is_file() {
            return Ok(Self::none());
        }
        let text = std::fs::read_to_string(&path).map_err(SyntheticError::io(&path))?;
        let read = serde_json::from_str(&text);
        read.map(Self)
            .map_err(|error| SyntheticError::Message(format!("{}: {error}; mend or remove it", path.display())))
    }

    /// Nothing is stated.
    fn none() -> Self {
        Self(BTreeMap::new())
    }

    /// The origin of what is called `key` there; `name` where no other is stated.
    pub(super) fn origin(&self, key: &str, name: &str) -> Origin {
        let meta = self.0.get(key);
        let text = |of: fn(&Meta) -> &Option<String>| meta.and_then(|m| of(m).clone());
        Origin {
            name: text(|m| &m.name).unwrap_or_else(|| name.to_owned()),
            source: text(|m| &m.source).unwrap_or_else(|| "not stated".to_owned()),
            licence: text(|m| &m.licence).unwrap_or_else(|| "not stated".to_owned()),
            ship: meta.and_then(|m| m.ship.clone()).unwrap_or_else(|| Ship::Unclear("not stated".to_owned())),
        }
    }
}

impl Origin {
    /// Whether nothing speaks against shipping: stated as shippable, or the user's own, of which nothing is stated.
    pub(super) fn is_free(&self) -> bool {
        self.ship == Ship::Stated(true) || (self.source == "not stated" && self.licence == "not stated")
    }
}

impl Card {
    pub(super) fn new(objects: Vec<Origin>, pictures: Vec<Origin>, procedural_shapes: usize) -> Self {
        let may_ship = objects.iter().chain(&pictures).all(|origin| origin.ship == Ship::Stated(true));
        Self { may_ship, procedural_shapes, objects, pictures }
    }

    /// For a file.
    #[must_use]
    pub fn to_json(&self) -> String {
        serde_json::to_string_pretty(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_are_read_and_what_is_missing_is_said() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Statements::of_folder(folder.path()).unwrap().origin("1", "obj_000001").licence, "not stated");
        let meta = r#"{"1": {"name": "mug", "source": "somebody", "licence": "CC0", "ship": true, "faces": 12},
            "2": {"source": "x", "licence": "y", "ship": false}, "3": {"source": "x", "ship": "as stated there"}}"#;
        std::fs::write(folder.path().join("meta.json"), meta).unwrap();
        let statements = Statements::of_folder(folder.path()).unwrap();
        let of = |key: &str| statements.origin(key, "other");
        assert_eq!((of("1").name.as_str(), of("1").is_free()), ("mug", true));
        assert!(!of("2").is_free() && !of("3").is_free() && of("4").is_free());
        assert!(Card::new(vec![of("1")], vec![], 0).may_ship && !Card::new(vec![of("1"), of("4")], vec![], 0).may_ship);
        let card = Card::new(vec![of("1"), of("3")], vec![of("2")], 7);
        assert_eq!(serde_json::from_str::<Card>(&card.to_json()).unwrap(), card);
        std::fs::write(folder.path().join("meta.json"), "[").unwrap();
        assert!(Statements::of_folder(folder.path()).is_err_and(|e| e.to_string().contains("meta.json")));
    }
}
