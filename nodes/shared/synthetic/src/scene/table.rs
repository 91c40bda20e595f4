//! A whole scene: several objects of the set on a table or in the air, with other things between them.

use super::{Look, Skin, Stock, Surroundings, SyntheticScene, Thing};
use crate::light::{Lighting, Material};
use crate::pattern::Pattern;
use crate::pose::centre_m;
use crate::random::Draw;
use crate::scene_images::SceneConfig;
use crate::simple_shapes::{draw_shape, finger, skin};
use nalgebra::{Point2, Point3, Translation3, UnitQuaternion, Vector3};
use pseudoflow_geometry::{Intrinsics, Pose};
use pseudoflow_imaging::ImagingError;
use rand::Rng;
use std::sync::Arc;

/// An object at its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Placed {
    pub(crate) object_id: u32,
    pub(crate) camera_from_object: Pose,
}

/// Things that do not touch: centres and radii, metres.
#[derive(Default)]
struct Occupied(Vec<(Point3<f64>, f64)>);

impl Occupied {
    /// Whether a ball has room; flat things may come closer than their diameters say.
    fn has_room(&self, centre: &Point3<f64>, radius_m: f64) -> bool {
        self.0.iter().all(|(other, r)| (centre - other).norm() > 0.5 * (radius_m + r))
    }
}

/// Tries to find room for a thing before it is left out.
const TRIES: usize = 12;

/// Where things may stand.
struct Table<'a> {
    intrinsics: &'a Intrinsics,
    image_px: [f64; 2],
    centre: Point3<f64>,
    up: Vector3<f64>,
    on_table: bool,
}

impl SyntheticScene {
    /// Draws a scene of several objects; the first things are those of the returned list, in its order. With `clutter` the other
    /// things, table and wall are made from that, without they are simple shapes with patterns.
    pub(crate) fn draw_set(
        rng: &mut impl Rng,
        stock: &Stock<'_>,
        clutter: Option<&Stock<'_>>,
        intrinsics: &Intrinsics,
        config: &SceneConfig,
    ) -> Result<(Self, Vec<Placed>), ImagingError> {
        let objects = stock.objects;
        let diameter_m = objects.iter().map(|o| o.diameter_m).sum::<f64>() / objects.len() as f64;
        let projected_px = rng.log_uniform(config.projected_px[0], config.projected_px[1]);
        let z_m = (intrinsics.fx * diameter_m / projected_px).max(2.0 * diameter_m);
        let middle = intrinsics.unproject(&Point2::new(intrinsics.cx, intrinsics.cy), z_m);
        let (elevation, roll) = (rng.uniform(12.0, 80.0).to_radians(), rng.uniform(-15.0, 15.0).to_radians());
        let upright = Vector3::new(0.0, -elevation.cos(), -elevation.sin());
        let up = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll) * upright;
        let on_table = rng.chance(0.85);
        let table = Table { intrinsics, image_px: config.image_px.map(f64::from), centre: middle, up, on_table };
        let mut occupied = Occupied::default();
        let (mut placed, mut things) = (Vec::new(), Vec::new());
        for _ in 0..(2 + rng.below(config.most_objects as usize)).min(config.most_objects as usize) {
            if let Some((at, thing)) = table.object(rng, stock, &mut occupied) {
                placed.push(at);
                things.push(thing);
            }
        }
        let table_m = on_table.then(|| up.dot(&middle.coords));
        let around = Surroundings { intrinsics, centre: middle, diameter_m: 1.5 * diameter_m, up, table_m };
        for _ in 0..rng.below(config.most_others as usize + 1) {
            let other = match clutter {
                Some(clutter) => table.thing(rng, clutter, &around, &mut occupied)?,
                None => table.shape(rng, stock, diameter_m, &mut occupied)?,
            };
            things.extend(other);
        }
        if rng.chance(config.occluded) {
            things.push(table.hanging(rng, stock, diameter_m)?);
        }
        let ground = around.ground(rng, clutter.unwrap_or(stock))?;
        let (centre_m, wide_m) = (middle.coords.map(|v| v as f32), (3.0 * diameter_m) as f32);
        let lighting = Lighting::draw(rng, stock.look, up.map(|v| v as f32), centre_m, wide_m);
        // Drawn last, and not at all without arms: the rest of a scene is the same with and without.
        if config.reached_into > 0.0 && !placed.is_empty() && rng.chance(config.reached_into) {
            let reached_for = Point3::from(things[rng.below(placed.len())].camera_from_thing.translation.vector);
            things.push(table.arm(rng, stock, diameter_m, &reached_for)?);
        }
        Ok((Self { things, ground, lighting, centre_m, diameter_m: wide_m }, placed))
    }
}

impl Table<'_> {
    /// A place seen by the camera: on the table, or anywhere about as far.
    fn place(&self, rng: &mut impl Rng) -> Option<Point3<f64>> {
        let [width, height] = self.image_px;
        let pixel = Point2::new(rng.uniform(-0.02, 1.02) * width, rng.uniform(0.08, 1.02) * height);
        let ray = self.intrinsics.unproject(&pixel, 1.0).coords;
        let z_m = if self.on_table {
            self.up.dot(&self.centre.coords) / self.up.dot(&ray)
        } else {
            self.centre.z * rng.uniform(0.6, 1.6)
        };
        (z_m > 0.55 * self.centre.z && z_m < 1.7 * self.centre.z).then(|| Point3::from(ray * z_m))
    }

    /// Lying or standing as a box would, or any way round.
    fn orientation(&self, rng: &mut impl Rng) -> UnitQuaternion<f64> {
        if !self.on_table || rng.chance(0.15) {
            return rng.rotation();
        }
        let axes = [Vector3::x(), Vector3::y(), Vector3::z(), -Vector3::x(), -Vector3::y(), Vector3::z()];
        let axis = axes[rng.below(axes.len())];
        let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let stand = UnitQuaternion::rotation_between(&axis, &self.up).unwrap_or_else(half_turn);
        let turn = UnitQuaternion::from_scaled_axis(self.up * rng.uniform(0.0, std::f64::consts::TAU));
        turn * stand
    }

    /// One of the objects, where there is room for it.
    fn object(&self, rng: &mut impl Rng, stock: &Stock<'_>, occupied: &mut Occupied) -> Option<(Placed, Thing)> {
        let object = stock.objects.at(rng.below(stock.objects.len()));
        for _ in 0..TRIES {
            let (at, rotation) = (self.place(rng), self.orientation(rng));
            let Some(at) = at else { continue };
            let mut thing = Thing {
                mesh: Arc::clone(&object.mesh),
                camera_from_thing: Pose::from_parts(Translation3::from(at - rotation * centre_m(object)), rotation),
                look: Look { material: Material::of_target(rng, stock.look), skin: Skin::Own },
                in_front: false,
            };
            self.stand(&mut thing);
            let centre = thing.camera_from_thing * centre_m(object);
            let radius_m = object.diameter_m / 2.0;
            if centre.z > 1.2 * object.diameter_m && occupied.has_room(&centre, radius_m) {
                occupied.0.push((centre, radius_m));
                return Some((Placed { object_id: object.id, camera_from_object: thing.camera_from_thing }, thing));
            }
        }
        None
    }

    /// Something that is not of the set: another object, a box or card with a photograph, a shape with a pattern.
    fn thing(
        &self,
        rng: &mut impl Rng,
        clutter: &Stock<'_>,
        around: &Surroundings<'_>,
        occupied: &mut Occupied,
    ) -> Result<Option<Thing>, ImagingError> {
        for _ in 0..TRIES {
            let Some(at) = self.place(rng) else { continue };
            let mut thing = Thing { in_front: true, ..around.draw_thing(rng, clutter, at)? };
            self.stand(&mut thing);
            let (low, high) = thing.mesh.bounds_m();
            let (centre, size_m) = (thing.camera_from_thing * nalgebra::center(&low, &high), (high - low).norm());
            if centre.z > size_m && occupied.has_room(&centre, size_m / 2.0) {
                occupied.0.push((centre, size_m / 2.0));
                return Ok(Some(thing));
            }
        }
        Ok(None)
    }

    /// A shape with a pattern.
    fn shape(
        &self,
        rng: &mut impl Rng,
        stock: &Stock<'_>,
        diameter_m: f64,
        occupied: &mut Occupied,
    ) -> Result<Option<Thing>, ImagingError> {
        let size_m = diameter_m * rng.log_uniform(0.3, 1.6);
        for _ in 0..TRIES {
            let Some(at) = self.place(rng) else { continue };
            let mut thing = shape(rng, stock, size_m, at)?;
            self.stand(&mut thing);
            let centre = Point3::from(thing.camera_from_thing.translation.vector);
            if centre.z > size_m && occupied.has_room(&centre, size_m / 2.0) {
                occupied.0.push((centre, size_m / 2.0));
                return Ok(Some(thing));
            }
        }
        Ok(None)
    }

    /// Something nearer to the camera than everything else.
    fn hanging(&self, rng: &mut impl Rng, stock: &Stock<'_>, diameter_m: f64) -> Result<Thing, ImagingError> {
        let [width, height] = self.image_px;
        let pixel = Point2::new(rng.uniform(0.0, width), rng.uniform(0.0, height));
        let at = self.intrinsics.unproject(&pixel, self.centre.z * rng.uniform(0.4, 0.75));
        let size_m = diameter_m * rng.log_uniform(0.2, 0.8);
        shape(rng, stock, size_m, at)
    }

    /// An arm from any side of the image that ends near a point, between it and the camera, so that a part of what stands there is hidden.
    fn arm(
        &self,
        rng: &mut impl Rng,
        stock: &Stock<'_>,
        diameter_m: f64,
        reached_for: &Point3<f64>,
    ) -> Result<Thing, ImagingError> {
        let radius_m = diameter_m * rng.log_uniform(0.08, 0.3);
        let half_m = diameter_m * rng.uniform(1.5, 3.0);
        let angle = rng.uniform(0.0, std::f64::consts::TAU);
        // From its end to the shoulder.
        let away = Vector3::new(angle.cos(), angle.sin(), rng.uniform(-0.8, 0.2)).normalize();
        // Its end lies on the ray of the point or somewhat beside it, nearer to the camera.
        let depth = (1.0 - diameter_m * rng.uniform(0.4, 1.2) / reached_for.z).max(0.4);
        let end = reached_for.coords * depth - away * diameter_m * rng.uniform(-0.5, 0.6);
        let along = UnitQuaternion::rotation_between(&Vector3::z(), &away).unwrap_or_default();
        let red = rng.uniform32(0.25, 0.95);
        let colour = if rng.chance(0.5) { skin(rng, red) } else { rng.colour(0.9, (0.1, 0.9)) };
        let pattern = if rng.chance(0.7) { Pattern::soft(rng, colour) } else { Pattern::draw(rng, true) };
        Ok(Thing {
            mesh: Arc::new(finger(radius_m as f32, half_m as f32)?),
            camera_from_thing: Pose::from_parts(Translation3::from(end + away * half_m), along),
            look: Look::pattern(Material::of_distractor(rng, stock.look), pattern, diameter_m as f32),
            in_front: true,
        })
    }

    /// Lowers or lifts a thing onto the table.
    fn stand(&self, thing: &mut Thing) {
        if self.on_table {
            let lift_m = self.up.dot(&self.centre.coords) - thing.lowest_m(&self.up);
            thing.camera_from_thing.translation.vector += self.up * lift_m;
        }
    }
}

fn shape(rng: &mut impl Rng, stock: &Stock<'_>, size_m: f64, at: Point3<f64>) -> Result<Thing, ImagingError> {
    let busy = rng.chance(0.6);
    let material = Material::of_distractor(rng, stock.look);
    let look = Look::pattern(material, Pattern::draw(rng, busy), size_m as f32);
    let camera_from_thing = Pose::from_parts(Translation3::from(at.coords), rng.rotation());
    Ok(Thing { mesh: Arc::new(draw_shape(rng, size_m as f32)?), camera_from_thing, look, in_front: true })
}
