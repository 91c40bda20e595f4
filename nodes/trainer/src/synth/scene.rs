//! A scene around the object: a table or nothing, a wall, other things behind and in front, and its picture.

mod table;

pub(super) use table::Placed;

use super::SynthConfig;
use super::light::{Lighting, Material};
use super::pattern::Pattern;
use super::picture::Picture;
use super::pool::ObjectPool;
use super::pose::{Stand, centre_m};
use super::random::Draw;
use super::things::{draw_shape, finger, sheet};
use super::window::Window;
use nalgebra::{Point2, Point3, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::raster::{Item, Surface};
use pseudoflow_imaging::{ImagingError, Mesh, Object};
use rand::Rng;
use std::sync::Arc;

/// A thing at its place. The object to be found is the first of a scene.
struct Thing {
    mesh: Arc<Mesh>,
    camera_from_thing: Pose,
    look: Look,
    /// Stands between camera and object.
    in_front: bool,
}

/// What a thing looks like: its material on its own texture, or on a pattern of a given unit (metres).
struct Look {
    material: Material,
    pattern: Option<(Pattern, f32)>,
}

/// All that can be seen, and the light. Camera frame, metres.
pub(super) struct SyntheticScene {
    things: Vec<Thing>,
    /// Table and wall: they receive shadows but cast none.
    ground: Vec<Thing>,
    lighting: Lighting,
    centre_m: Vector3<f32>,
    diameter_m: f32,
}

/// Where things are placed: the object's surroundings in the image.
struct Surroundings<'a> {
    intrinsics: &'a Intrinsics,
    centre: Point3<f64>,
    diameter_m: f64,
    up: Vector3<f64>,
    /// Height of the table along `up`; `None` when the object is in the air.
    table_m: Option<f64>,
}

impl SyntheticScene {
    /// Draws everything but the object, which stands at its true pose.
    pub(super) fn draw(
        rng: &mut impl Rng,
        objects: &ObjectPool,
        object: &Object,
        stand: &Stand,
        config: &SynthConfig,
    ) -> Result<Self, ImagingError> {
        let around = Surroundings::draw(rng, object, stand);
        let material = Material::of_target(rng);
        let target = Thing {
            mesh: Arc::clone(&object.mesh),
            camera_from_thing: stand.truth_camera_from_object,
            look: Look { material, pattern: None },
            in_front: false,
        };
        let mut things = vec![target];
        if rng.chance(config.occluded) {
            around.add_occluders(rng, objects, &mut things)?;
        }
        for _ in 0..rng.below(5) {
            around.add_neighbour(rng, objects, &mut things)?;
        }
        let ground = around.ground(rng)?;
        let (centre_m, diameter_m) = (around.centre.coords.map(|v| v as f32), around.diameter_m as f32);
        let lighting = Lighting::draw(rng, around.up.map(|v| v as f32), centre_m, diameter_m);
        Ok(Self { things, ground, lighting, centre_m, diameter_m })
    }

    /// The object.
    pub(super) fn target(&self) -> Item<'_> {
        self.things[0].item()
    }

    /// Takes away what stands between camera and object.
    pub(super) fn remove_occluders(&mut self) {
        self.things.retain(|thing| !thing.in_front);
    }

    /// Renders the window of the camera's image.
    pub(super) fn render(&self, window: &Window) -> Picture {
        let casting: Vec<Item<'_>> = self.things.iter().map(Thing::item).collect();
        let shadow = self.lighting.shadow_map(&casting, self.centre_m, self.diameter_m);
        let all: Vec<&Thing> = self.things.iter().chain(&self.ground).collect();
        let items: Vec<Item<'_>> = all.iter().map(|thing| thing.item()).collect();
        let shade = |surface: &Surface| {
            let look = &all[surface.item].look;
            let albedo = look.albedo(surface);
            self.lighting.shade(&Surface { albedo, ..*surface }, &look.material, shadow.as_ref())
        };
        Picture::render(&items, window, shade)
    }
}

impl Look {
    /// sRGB-encoded, 0 to 1.
    fn albedo(&self, surface: &Surface) -> [f32; 3] {
        let Some((pattern, unit_m)) = &self.pattern else { return surface.albedo };
        let scale = 1.0 / unit_m;
        let [x, y, z] = surface.point_in_object.map(|c| c * scale);
        pattern.colour(x + 0.35 * z, y + 0.8 * z)
    }
}

impl<'a> Surroundings<'a> {
    fn draw(rng: &mut impl Rng, object: &Object, stand: &'a Stand) -> Self {
        let truth = &stand.truth_camera_from_object;
        let (elevation, roll) = (rng.uniform(8.0, 85.0).to_radians(), rng.uniform(-20.0, 20.0).to_radians());
        let upright = Vector3::new(0.0, -elevation.cos(), -elevation.sin());
        let up = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll) * upright;
        let lowest = object.hull_m.iter().map(|p| up.dot(&(truth * p).coords)).fold(f64::MAX, f64::min);
        let gap_m = if rng.chance(0.7) { 0.0 } else { rng.uniform(0.0, 0.5) * object.diameter_m };
        let table_m = rng.chance(0.75).then_some(lowest - gap_m);
        Self {
            intrinsics: &stand.intrinsics,
            centre: truth * centre_m(object),
            diameter_m: object.diameter_m,
            up,
            table_m,
        }
    }

    /// A point `offset` projected diameters beside the object's centre, at another depth.
    fn beside(&self, rng: &mut impl Rng, offset: f64, z_m: f64) -> Point3<f64> {
        let k = self.intrinsics;
        let angle = rng.uniform(0.0, std::f64::consts::TAU);
        let shift = offset * self.diameter_m / self.centre.z;
        let (x, y) =
            (self.centre.x / self.centre.z + shift * angle.cos(), self.centre.y / self.centre.z + shift * angle.sin());
        k.unproject(&Point2::new(k.fx * x + k.cx, k.fy * y + k.cy), z_m)
    }

    /// Something beside or behind, often standing on the table.
    fn add_neighbour(
        &self,
        rng: &mut impl Rng,
        objects: &ObjectPool,
        things: &mut Vec<Thing>,
    ) -> Result<(), ImagingError> {
        let z_m = self.centre.z + self.diameter_m * rng.uniform(0.0, 2.5);
        let offset = rng.uniform(0.5, 1.5);
        let at = self.beside(rng, offset, z_m);
        let mut thing = self.draw_thing(rng, objects, at)?;
        if let (Some(table_m), true) = (self.table_m, rng.chance(0.8)) {
            let bottom = thing.lowest_m(&self.up);
            thing.camera_from_thing.translation.vector += self.up * (table_m - bottom);
        }
        things.push(thing);
        Ok(())
    }

    /// One or two things before the object, or a hand.
    fn add_occluders(
        &self,
        rng: &mut impl Rng,
        objects: &ObjectPool,
        things: &mut Vec<Thing>,
    ) -> Result<(), ImagingError> {
        if rng.chance(0.3) {
            return self.add_hand(rng, things);
        }
        for _ in 0..1 + rng.below(2) {
            let z_m = self.before(rng);
            let offset = rng.uniform(0.25, 0.7);
            let at = self.beside(rng, offset, z_m);
            things.push(Thing { in_front: true, ..self.draw_thing(rng, objects, at)? });
        }
        Ok(())
    }

    fn before(&self, rng: &mut impl Rng) -> f64 {
        (self.centre.z - self.diameter_m * rng.uniform(0.4, 1.3)).max(0.35 * self.centre.z)
    }

    /// An object of the set or a random shape.
    fn draw_thing(&self, rng: &mut impl Rng, objects: &ObjectPool, at: Point3<f64>) -> Result<Thing, ImagingError> {
        let rotation = rng.rotation();
        let object = objects.at(rng.below(objects.len()));
        if rng.chance(0.5) {
            let camera_from_thing = Pose::from_parts(Translation3::from(at - rotation * centre_m(object)), rotation);
            let look = Look { material: Material::of_distractor(rng), pattern: None };
            return Ok(Thing { mesh: Arc::clone(&object.mesh), camera_from_thing, look, in_front: false });
        }
        let size_m = self.diameter_m as f32 * rng.log_uniform32(0.3, 1.5);
        let busy = rng.chance(0.6);
        let pattern = Some((Pattern::draw(rng, busy), size_m));
        let look = Look { material: Material::of_distractor(rng), pattern };
        let camera_from_thing = Pose::from_parts(Translation3::from(at.coords), rotation);
        Ok(Thing { mesh: Arc::new(draw_shape(rng, size_m)?), camera_from_thing, look, in_front: false })
    }

    /// Two to four parallel fingers that reach over the edge of the object.
    fn add_hand(&self, rng: &mut impl Rng, things: &mut Vec<Thing>) -> Result<(), ImagingError> {
        let skin = [rng.uniform32(0.35, 0.95), rng.uniform32(0.6, 0.8), rng.uniform32(0.7, 0.95)];
        let skin = [skin[0], skin[0] * skin[1], skin[0] * skin[1] * skin[2]];
        let (radius_m, half_m) = (rng.uniform32(0.006, 0.012), rng.uniform32(0.03, 0.07));
        let mesh = Arc::new(finger(radius_m, half_m)?);
        let z_m = (self.centre.z - self.diameter_m * rng.uniform(0.3, 0.7)).max(0.5 * self.centre.z);
        let offset = rng.uniform(0.25, 0.55);
        let (at, rotation) = (self.beside(rng, offset, z_m), rng.rotation());
        let spread = rotation * Vector3::x() * f64::from(radius_m) * 2.2;
        let material = Material::of_target(rng);
        for i in 0..2 + rng.below(3) {
            let bent = rotation * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), rng.uniform(-0.15, 0.15));
            let camera_from_thing = Pose::from_parts(Translation3::from(at.coords + spread * i as f64), bent);
            let look = Look { material: material.clone(), pattern: Some((Pattern::soft(rng, skin), 0.05)) };
            things.push(Thing { mesh: Arc::clone(&mesh), camera_from_thing, look, in_front: true });
        }
        Ok(())
    }

    /// The table, if any, and a wall behind everything.
    fn ground(&self, rng: &mut impl Rng) -> Result<Vec<Thing>, ImagingError> {
        let far_m = self.centre.z
            + self.diameter_m * if self.table_m.is_some() { rng.uniform(3.0, 12.0) } else { rng.uniform(0.8, 6.0) };
        let tilt = rng.direction().map(f64::from) * 0.4;
        let mut ground = Vec::with_capacity(2);
        if let Some(table_m) = self.table_m {
            let foot = self.centre + self.up * (table_m - self.up.dot(&self.centre.coords));
            ground.push(self.backdrop(rng, foot, &self.up)?);
        }
        let behind = self.centre * (far_m / self.centre.z);
        ground.push(self.backdrop(rng, behind, &(tilt - Vector3::z()))?);
        Ok(ground)
    }

    /// A patterned plane through a point, seen from the side of its normal.
    fn backdrop(&self, rng: &mut impl Rng, through: Point3<f64>, normal: &Vector3<f64>) -> Result<Thing, ImagingError> {
        let to_normal = UnitQuaternion::rotation_between(&Vector3::z(), normal)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let busy = rng.chance(0.35);
        let unit_m = (self.diameter_m * rng.log_uniform(0.5, 3.0)) as f32;
        let look = Look { material: Material::of_target(rng), pattern: Some((Pattern::draw(rng, busy), unit_m)) };
        let mesh = Arc::new(sheet(60.0 * (self.diameter_m as f32).max(0.1))?);
        let camera_from_thing = Pose::from_parts(Translation3::from(through.coords), to_normal);
        Ok(Thing { mesh, camera_from_thing, look, in_front: false })
    }
}

impl Thing {
    fn item(&self) -> Item<'_> {
        Item { mesh: &self.mesh, camera_from_object: self.camera_from_thing }
    }

    /// Lowest extent along `up`, metres, camera frame.
    fn lowest_m(&self, up: &Vector3<f64>) -> f64 {
        let step = (self.mesh.vertices_m.len() / 500).max(1);
        let along = |v: &[f32; 3]| up.dot(&(self.camera_from_thing * Point3::from(v.map(f64::from))).coords);
        self.mesh.vertices_m.iter().step_by(step).map(along).fold(f64::MAX, f64::min)
    }
}
