//! What objects are called outside: `class_id` in detections, and the token in topics and frames.

use super::{BoundingBox3D, Pose, Vector3};
use crate::ObjectPose;
use std::collections::BTreeMap;

/// The box around a mesh, in the mesh's own frame and along its axes, metres.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ObjectBox {
    /// Its middle.
    pub centre_m: [f64; 3],
    /// Its edges.
    pub size_m: [f64; 3],
}

/// Names, tokens and boxes of objects, by id.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Naming {
    names: BTreeMap<u32, String>,
    tokens: BTreeMap<u32, String>,
    boxes: BTreeMap<u32, ObjectBox>,
}

/// Two objects that could not be told apart outside.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NamingError {
    /// Detections could not tell them apart.
    #[error("object {id} is called `{name}`, which is the name or the id of another object: rename one (names.json)")]
    Name {
        /// The object.
        id: u32,
        /// Its name.
        name: String,
    },
    /// Topics and frames could not tell them apart.
    #[error(
        "objects `{first}` and `{second}` would both have the topic objects/{token}/pose and the frame {token}: rename one (names.json)"
    )]
    Token {
        /// One name.
        first: String,
        /// The other.
        second: String,
        /// What both become.
        token: String,
    },
    /// A name that no object has.
    #[error("`object: {name}`: there is no such object; the set has {known:?}: name one of them, or its id")]
    Unknown {
        /// What was asked for.
        name: String,
        /// All names.
        known: Vec<String>,
    },
}

impl Naming {
    /// Takes names by object id.
    ///
    /// # Errors
    /// When two have one name, one has another's id for a name, or two have one topic or frame.
    pub fn new(names: BTreeMap<u32, String>) -> Result<Self, NamingError> {
        let tokens = names.iter().map(|(id, name)| (*id, token(*id, name))).collect();
        let naming = Self { names, tokens, boxes: BTreeMap::new() };
        let ambiguous = naming.names.iter().find(|(id, name)| naming.object_id(name) != Some(**id));
        if let Some((id, name)) = ambiguous {
            return Err(NamingError::Name { id: *id, name: name.clone() });
        }
        naming.check_tokens().map(|()| naming)
    }

    /// Adds the boxes around the meshes.
    #[must_use]
    pub fn with_boxes(self, boxes: BTreeMap<u32, ObjectBox>) -> Self {
        Self { boxes, ..self }
    }

    fn check_tokens(&self) -> Result<(), NamingError> {
        for (first, one) in &self.tokens {
            for (second, other) in &self.tokens {
                let instance = one.strip_prefix(other.as_str()).and_then(|rest| rest.strip_prefix('_'));
                let is_instance = instance.is_some_and(|text| instance_of(text).is_some());
                if first != second && (one == other || is_instance) {
                    let name = |id| self.class_id(id);
                    return Err(NamingError::Token { first: name(*first), second: name(*second), token: one.clone() });
                }
            }
        }
        Ok(())
    }

    /// The object's name, or its id in digits where it has none.
    #[must_use]
    pub fn class_id(&self, object_id: u32) -> String {
        self.names.get(&object_id).cloned().unwrap_or_else(|| object_id.to_string())
    }

    /// The object that somebody means: by name, or by id in digits.
    #[must_use]
    pub fn object_id(&self, class_id: &str) -> Option<u32> {
        let by_digits = class_id.parse().ok();
        by_digits.or_else(|| self.names.iter().find(|(_, name)| *name == class_id).map(|(id, _)| *id))
    }

    /// The object that a configuration's `object: NAME` means.
    ///
    /// # Errors
    /// When there is no such object.
    pub fn wanted(&self, name: &str) -> Result<u32, NamingError> {
        let known = || self.names.values().cloned().collect();
        let found = self.object_id(name).filter(|id| self.is_known(*id));
        found.ok_or_else(|| NamingError::Unknown { name: name.to_owned(), known: known() })
    }

    /// Whether an object may be spoken of: every one where none has a name.
    #[must_use]
    pub fn is_known(&self, object_id: u32) -> bool {
        self.names.is_empty() || self.names.contains_key(&object_id)
    }

    /// All objects with a name, by ascending id.
    pub fn named(&self) -> impl Iterator<Item = (u32, &str)> {
        self.names.iter().map(|(id, name)| (*id, name.as_str()))
    }

    /// What topics and frames call an instance: `mustard`, `mustard_1` for the second; `object_5` without a name.
    #[must_use]
    pub fn token(&self, object_id: u32, instance: u32) -> String {
        let token = self.tokens.get(&object_id).cloned().unwrap_or_else(|| format!("object_{object_id}"));
        match instance {
            0 => token,
            instance => format!("{token}_{instance}"),
        }
    }

    /// The instance that a detection's `id` names, as [`Self::token`] writes it.
    #[must_use]
    pub fn instance(&self, object_id: u32, id: &str) -> Option<u32> {
        let rest = id.strip_prefix(&self.token(object_id, 0))?;
        if rest.is_empty() { Some(0) } else { instance_of(rest.strip_prefix('_')?) }
    }

    /// The box of an object at `camera_from_object`; of size 0 where its mesh is not known.
    #[must_use]
    pub fn bounding_box(&self, pose: &ObjectPose) -> BoundingBox3D {
        let ObjectBox { centre_m, size_m: [x, y, z] } = self.boxes.get(&pose.object_id).copied().unwrap_or_default();
        let centre = rotate(pose.rotation_xyzw, centre_m);
        let mut center = Pose::from(pose);
        center.position.x += centre[0];
        center.position.y += centre[1];
        center.position.z += centre[2];
        BoundingBox3D { center, size: Vector3 { x, y, z } }
    }
}

/// `p` turned by a unit quaternion x, y, z, w: p + 2 w (v x p) + 2 v x (v x p).
fn rotate([x, y, z, w]: [f64; 4], p: [f64; 3]) -> [f64; 3] {
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let v = [x, y, z];
    let once = cross(v, p);
    let twice = cross(v, once);
    std::array::from_fn(|i| p[i] + 2.0 * (w * once[i] + twice[i]))
}

/// A name as ROS 2 allows it in topics: letters, digits and single `_`, no digit in front.
fn token(id: u32, name: &str) -> String {
    let mut token = String::new();
    for c in name.chars() {
        let c = if c.is_ascii_alphanumeric() { c } else { '_' };
        if !(c == '_' && token.ends_with('_')) {
            token.push(c);
        }
    }
    let token = token.trim_matches('_');
    match token.chars().next() {
        None => format!("object_{id}"),
        Some(first) if first.is_ascii_digit() => format!("object_{token}"),
        Some(_) => token.to_owned(),
    }
}

/// The number behind a token: 1 and up, as it is written.
fn instance_of(text: &str) -> Option<u32> {
    let instance: u32 = text.parse().ok()?;
    (instance > 0 && instance.to_string() == text).then_some(instance)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(list: &[&str]) -> Result<Naming, NamingError> {
        Naming::new(list.iter().enumerate().map(|(i, name)| (i as u32 + 1, (*name).to_owned())).collect())
    }

    #[test]
    fn names_must_be_unambiguous() {
        assert!(matches!(names(&["a", "a"]), Err(NamingError::Name { id: 2, .. })));
        assert!(matches!(names(&["2", "b"]), Err(NamingError::Name { id: 1, .. })));
        assert!(names(&["a", "2"]).is_ok());
    }

    #[test]
    fn two_objects_with_one_topic_are_refused() {
        for pair in [["soup can", "soup_can"], ["soup-can", "soup__can"], ["cup", "cup_1"], ["object_7", "7"]] {
            let Err(error) = names(&pair) else { panic!("{pair:?} was taken") };
            assert!(pair == ["object_7", "7"] || matches!(error, NamingError::Token { .. }), "{error}");
        }
        assert!(names(&["cup", "cup_01", "cup_b"]).is_ok());
    }

    #[test]
    fn tokens_are_what_ros_allows() {
        let naming = names(&["cracker box", "003_mustard", "Tasse (groß)", "§"]).unwrap();
        let tokens: Vec<_> = (1..=5).map(|id| naming.token(id, 0)).collect();
        assert_eq!(tokens, ["cracker_box", "object_003_mustard", "Tasse_gro", "object_4", "object_5"]);
        assert_eq!((naming.token(1, 2), naming.class_id(1)), ("cracker_box_2".into(), "cracker box".into()));
        assert_eq!(naming.object_id("cracker box"), Some(1));
        assert_eq!(naming.object_id("4"), Some(4));
        assert!(naming.is_known(4) && !naming.is_known(5) && Naming::default().is_known(5));
        for (id, instance) in
            [("cracker_box", Some(0)), ("cracker_box_2", Some(2)), ("cracker_box_02", None), ("cup", None)]
        {
            assert_eq!(naming.instance(1, id), instance);
        }
    }

    #[test]
    fn a_box_turns_with_its_object() {
        let boxes = [(1, ObjectBox { centre_m: [0.1, 0.0, 0.0], size_m: [0.4, 0.2, 0.1] })].into();
        let naming = names(&["cup"]).unwrap().with_boxes(boxes);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let mut pose: ObjectPose = bytemuck::Zeroable::zeroed();
        (pose.object_id, pose.rotation_xyzw, pose.translation_m) = (1, [0.0, 0.0, half, half], [1.0, 2.0, 3.0]);
        let found = naming.bounding_box(&pose);
        let at = found.center.position;
        assert!((at.x - 1.0).abs() < 1e-12 && (at.y - 2.1).abs() < 1e-12 && at.z == 3.0, "{at:?}");
        assert_eq!(found.size, Vector3 { x: 0.4, y: 0.2, z: 0.1 });
    }
}
