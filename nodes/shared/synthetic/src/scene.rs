//! A scene around the object: a table or nothing, a wall, other things behind and in front, and its picture.

mod table;

pub(super) use table::Placed;

use super::SynthConfig;
use super::config::LookConfig;
use super::light::{Lighting, Material};
use super::pattern::Pattern;
use super::photo::{Photo, PhotoBank};
use super::picture::Picture;
use super::pool::ObjectPool;
use super::pose::{Stand, centre_m};
use super::random::Draw;
use super::shapes::ShapeBank;
use super::simple_shapes::{draw_card, draw_shape, finger, sheet, skin};
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

/// What a thing looks like.
#[derive(Clone)]
struct Look {
    material: Material,
    skin: Skin,
}

/// What is on a surface.
#[derive(Clone)]
enum Skin {
    /// The mesh's own texture or colours.
    Own,
    /// A pattern and its unit, metres.
    Pattern(Arc<Pattern>, f32),
    /// A photograph on the thing's x-y plane: pixels per metre, the pixel at the origin, and the metres that a pixel of the
    /// camera sees at a distance of one metre.
    Photo { photo: Arc<Photo>, per_m: f32, origin: [f32; 2], footprint: f32 },
}

/// What scenes are made from.
#[derive(Clone, Copy)]
pub(super) struct Stock<'a> {
    pub(super) objects: &'a ObjectPool,
    pub(super) shapes: &'a ShapeBank,
    pub(super) photos: &'a PhotoBank,
    pub(super) look: &'a LookConfig,
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

impl Stock<'_> {
    /// An object, and its place: those of the pool first, then the procedural shapes, of which comes a given share.
    pub(super) fn any(&self, rng: &mut impl Rng, procedural: f64) -> Result<(usize, &Arc<Object>), ImagingError> {
        let procedural = rng.chance(procedural) || self.objects.len() == 0;
        let place = match procedural && self.shapes.len() > 0 {
            true => self.objects.len() + rng.below(self.shapes.len()),
            false => rng.below(self.objects.len()),
        };
        Ok((place, self.at(place)?))
    }

    pub(super) fn at(&self, place: usize) -> Result<&Arc<Object>, ImagingError> {
        match place.checked_sub(self.objects.len()) {
            Some(shape) => self.shapes.at(shape),
            None => Ok(self.objects.at(place)),
        }
    }
}

impl SyntheticScene {
    /// Draws everything but the object, which stands at its true pose.
    pub(super) fn draw(
        rng: &mut impl Rng,
        stock: &Stock<'_>,
        object: &Object,
        stand: &Stand,
        config: &SynthConfig,
    ) -> Result<Self, ImagingError> {
        let around = Surroundings::draw(rng, object, stand);
        let target = Thing {
            mesh: Arc::clone(&object.mesh),
            camera_from_thing: stand.truth_camera_from_object,
            look: Look { material: Material::of_target(rng, stock.look), skin: Skin::Own },
            in_front: false,
        };
        let mut things = vec![target];
        if rng.chance(config.occluded) {
            around.add_occluders(rng, stock, &mut things)?;
        }
        // Half of the scenes are tidy, half are not.
        let most = stock.look.most_neighbours;
        let few = rng.chance(0.5);
        for _ in 0..rng.below(if few { most.min(4) } else { most } + 1) {
            around.add_neighbour(rng, stock, &mut things)?;
        }
        let ground = around.ground(rng, stock)?;
        let (centre_m, diameter_m) = (around.centre.coords.map(|v| v as f32), around.diameter_m as f32);
        let lighting = Lighting::draw(rng, stock.look, around.up.map(|v| v as f32), centre_m, diameter_m);
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
        let shadows = self.lighting.shadows(&casting, self.centre_m, self.diameter_m);
        let all: Vec<&Thing> = self.things.iter().chain(&self.ground).collect();
        let items: Vec<Item<'_>> = all.iter().map(|thing| thing.item()).collect();
        let shade = |surface: &Surface| {
            let look = &all[surface.item].look;
            let albedo = look.albedo(surface);
            self.lighting.shade(&Surface { albedo, ..*surface }, &look.material, &shadows)
        };
        Picture::render(&items, window, shade)
    }
}

impl Look {
    /// sRGB-encoded, 0 to 1.
    fn albedo(&self, surface: &Surface) -> [f32; 3] {
        match &self.skin {
            Skin::Own => surface.albedo,
            Skin::Pattern(pattern, unit_m) => {
                let scale = 1.0 / unit_m;
                let [x, y, z] = surface.point_in_object.map(|c| c * scale);
                pattern.colour(x + 0.35 * z, y + 0.8 * z)
            }
            Skin::Photo { photo, per_m, origin, footprint } => {
                let [x, y, z] = surface.point_in_object.map(|c| c * per_m);
                // Seen at a slant a pixel covers more; half of that is taken, as its other side is not longer.
                let facing = surface.normal_in_camera.iter().zip(surface.to_camera).map(|(n, v)| n * v).sum::<f32>();
                let size = per_m * footprint * surface.point_in_camera[2] / facing.clamp(0.1, 1.0).sqrt();
                photo.colour(origin[0] + x + 0.35 * z, origin[1] + y + 0.8 * z, size)
            }
        }
    }

    fn pattern(material: Material, pattern: Pattern, unit_m: f32) -> Self {
        Self { material, skin: Skin::Pattern(Arc::new(pattern), unit_m) }
    }
}

impl<'a> Surroundings<'a> {
    fn draw(rng: &mut impl Rng, object: &Object, stand: &'a Stand) -> Self {
        let truth = &stand.truth_camera_from_object;
        let up = stand.up;
        let lowest = object.hull_m.iter().map(|p| up.dot(&(truth * p).coords)).fold(f64::MAX, f64::min);
        let gap_m = if rng.chance(0.7) { 0.0 } else { rng.uniform(0.0, 0.5) * object.diameter_m };
        let table_m = if stand.resting { Some(lowest) } else { rng.chance(0.6).then_some(lowest - gap_m) };
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
        stock: &Stock<'_>,
        things: &mut Vec<Thing>,
    ) -> Result<(), ImagingError> {
        let z_m = self.centre.z + self.diameter_m * rng.uniform(0.0, 2.5);
        let offset = rng.uniform(0.45, 1.3);
        let at = self.beside(rng, offset, z_m);
        let mut thing = self.draw_thing(rng, stock, at)?;
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
        stock: &Stock<'_>,
        things: &mut Vec<Thing>,
    ) -> Result<(), ImagingError> {
        if rng.chance(0.3) {
            return self.add_hand(rng, stock, things);
        }
        for _ in 0..1 + rng.below(2) {
            let z_m = self.before(rng);
            let offset = rng.uniform(0.25, 0.7);
            let at = self.beside(rng, offset, z_m);
            things.push(Thing { in_front: true, ..self.draw_thing(rng, stock, at)? });
        }
        Ok(())
    }

    fn before(&self, rng: &mut impl Rng) -> f64 {
        (self.centre.z - self.diameter_m * rng.uniform(0.4, 1.3)).max(0.35 * self.centre.z)
    }

    /// An object of the pool, a random shape with a pattern, or a box or card with a photograph.
    fn draw_thing(&self, rng: &mut impl Rng, stock: &Stock<'_>, at: Point3<f64>) -> Result<Thing, ImagingError> {
        let rotation = rng.rotation();
        if rng.chance(0.45) {
            let (_, object) = stock.any(rng, 0.7 * stock.look.procedural)?;
            let camera_from_thing = Pose::from_parts(Translation3::from(at - rotation * centre_m(object)), rotation);
            let look = Look { material: Material::of_distractor(rng, stock.look), skin: Skin::Own };
            return Ok(Thing { mesh: Arc::clone(&object.mesh), camera_from_thing, look, in_front: false });
        }
        let size_m = self.diameter_m as f32 * rng.log_uniform32(0.3, 1.5);
        let material = Material::of_distractor(rng, stock.look);
        let camera_from_thing = Pose::from_parts(Translation3::from(at.coords), rotation);
        let photo = if rng.chance(stock.look.photos) { stock.photos.draw(rng) } else { None };
        let (mesh, look) = match photo {
            Some(photo) => {
                let wide = photo.size_px()[0] as f32 * rng.uniform32(0.3, 1.0);
                let look = Look { material, skin: self.photo_skin(rng, photo, wide / size_m) };
                (draw_card(rng, size_m)?, look)
            }
            None => {
                let busy = rng.chance(0.6);
                (draw_shape(rng, size_m)?, Look::pattern(material, Pattern::draw(rng, busy), size_m))
            }
        };
        Ok(Thing { mesh: Arc::new(mesh), camera_from_thing, look, in_front: false })
    }

    /// A photograph with any of its places at the thing's origin.
    fn photo_skin(&self, rng: &mut impl Rng, photo: &Arc<Photo>, per_m: f32) -> Skin {
        let origin = photo.size_px().map(|size| rng.uniform32(0.0, size as f32));
        Skin::Photo { photo: Arc::clone(photo), per_m, origin, footprint: (1.0 / self.intrinsics.fx) as f32 }
    }

    /// Two to four parallel fingers that reach over the edge of the object.
    fn add_hand(&self, rng: &mut impl Rng, stock: &Stock<'_>, things: &mut Vec<Thing>) -> Result<(), ImagingError> {
        let red = rng.uniform32(0.35, 0.95);
        let skin = skin(rng, red);
        let (radius_m, half_m) = (rng.uniform32(0.006, 0.012), rng.uniform32(0.03, 0.07));
        let mesh = Arc::new(finger(radius_m, half_m)?);
        let z_m = (self.centre.z - self.diameter_m * rng.uniform(0.3, 0.7)).max(0.5 * self.centre.z);
        let offset = rng.uniform(0.25, 0.55);
        let (at, rotation) = (self.beside(rng, offset, z_m), rng.rotation());
        let spread = rotation * Vector3::x() * f64::from(radius_m) * 2.2;
        let material = Material::of_target(rng, stock.look);
        for i in 0..2 + rng.below(3) {
            let bent = rotation * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), rng.uniform(-0.15, 0.15));
            let camera_from_thing = Pose::from_parts(Translation3::from(at.coords + spread * i as f64), bent);
            let look = Look::pattern(material.clone(), Pattern::soft(rng, skin), 0.05);
            things.push(Thing { mesh: Arc::clone(&mesh), camera_from_thing, look, in_front: true });
        }
        Ok(())
    }

    /// The table, if any, and a wall behind everything.
    fn ground(&self, rng: &mut impl Rng, stock: &Stock<'_>) -> Result<Vec<Thing>, ImagingError> {
        let far_m = self.centre.z
            + self.diameter_m * if self.table_m.is_some() { rng.uniform(2.0, 10.0) } else { rng.uniform(0.8, 6.0) };
        let tilt = rng.direction().map(f64::from) * 0.4;
        let mut ground = Vec::with_capacity(2);
        if let Some(table_m) = self.table_m {
            let foot = self.centre + self.up * (table_m - self.up.dot(&self.centre.coords));
            ground.push(self.backdrop(rng, stock, foot, &self.up, 0.7)?);
        }
        let behind = self.centre * (far_m / self.centre.z);
        ground.push(self.backdrop(rng, stock, behind, &(tilt - Vector3::z()), 1.0)?);
        Ok(ground)
    }

    /// A plane through a point, seen from the side of its normal, with a pattern or (in parts `photos` of the configured
    /// share) a photograph.
    fn backdrop(
        &self,
        rng: &mut impl Rng,
        stock: &Stock<'_>,
        through: Point3<f64>,
        normal: &Vector3<f64>,
        photos: f64,
    ) -> Result<Thing, ImagingError> {
        let to_normal = UnitQuaternion::rotation_between(&Vector3::z(), normal)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let material = Material::of_target(rng, stock.look);
        let photo = if rng.chance(photos * stock.look.photos) { stock.photos.draw(rng) } else { None };
        let look = match photo {
            Some(photo) => {
                // A pixel of the photograph is as large as 0.4 to 2.5 pixels of the camera.
                let per_m = self.intrinsics.fx / through.z.abs().max(1e-3) / rng.log_uniform(0.4, 2.5);
                Look { material, skin: self.photo_skin(rng, photo, per_m as f32) }
            }
            None => {
                let busy = rng.chance(0.5);
                let unit_m = (self.diameter_m * rng.log_uniform(0.5, 3.0)) as f32;
                Look::pattern(material, Pattern::draw(rng, busy), unit_m)
            }
        };
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
