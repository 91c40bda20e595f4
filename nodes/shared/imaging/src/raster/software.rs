//! The software rasteriser: transform, cover (z-buffer of triangle numbers), then shade what is visible.

use super::coverage::Scratch;
use super::surface::{Headlight, Shader};
use super::{RasterError, Rasteriser, Rendering, View, check_view};
use crate::{BACKGROUND_GREY, Mesh, RgbImage};
use pseudoflow_geometry::{Intrinsics, Pose};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// An object in a scene.
#[derive(Debug, Clone, Copy)]
pub struct Item<'a> {
    /// Its mesh.
    pub mesh: &'a Mesh,
    /// Its pose, metres.
    pub camera_from_object: Pose,
}

/// What lies behind the objects.
#[derive(Debug, Clone, Copy)]
pub enum Background<'a> {
    /// One colour.
    Colour([u8; 3]),
    /// An image; where its size differs from the rendering's, its top left part, repeated.
    Image(&'a RgbImage),
}

/// Most objects in a scene: the mask has one byte a pixel.
pub const MAX_ITEMS: usize = 255;

/// Several objects before one camera; nearer ones hide farther ones.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The objects, at most [`MAX_ITEMS`]; further ones are not drawn.
    pub items: &'a [Item<'a>],
    /// The camera.
    pub intrinsics: Intrinsics,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// What lies behind.
    pub background: Background<'a>,
}

/// Draws a scene into `out`, which takes the scene's size.
pub fn render_scene<S: Shader>(scene: &Scene<'_>, shader: &S, scratch: &mut Scratch, out: &mut Rendering) {
    if (out.width(), out.height()) != (scene.width, scene.height) {
        *out = Rendering::new(scene.width, scene.height);
    }
    fill_background(scene, &mut out.rgb);
    scratch.cover(scene);
    out.mask.copy_from_slice(scratch.owners());
    out.depth_m.fill(0.0);
    let pixels = out.rgb.as_chunks_mut::<3>().0;
    let width = scene.width as usize;
    for i in (0..pixels.len()).filter(|&i| scratch.owners()[i] != 0) {
        let surface = scratch.surface_at(scene, i, [(i % width) as f64, (i / width) as f64], 1.0);
        out.depth_m[i] = surface.point_in_camera[2];
        pixels[i] = shader.shade(&surface).map(|c| (c * 255.0 + 0.5).clamp(0.0, 255.0) as u8);
    }
}

fn fill_background(scene: &Scene<'_>, rgb: &mut RgbImage) {
    match scene.background {
        Background::Colour(colour) => rgb.as_chunks_mut::<3>().0.fill(colour),
        Background::Image(image) if image.width() > 0 && image.height() > 0 => {
            for (x, y, pixel) in rgb.enumerate_pixels_mut() {
                *pixel = *image.get_pixel(x % image.width(), y % image.height());
            }
        }
        Background::Image(_) => rgb.fill(BACKGROUND_GREY),
    }
}

/// [`Rasteriser`] on the CPU. Views are rendered in parallel; each by one thread, so the bytes do not depend on it.
#[derive(Debug, Default)]
pub struct SoftwareRasteriser {
    objects: BTreeMap<u32, Arc<Mesh>>,
    /// Buffers that no render uses at the moment.
    scratch: Mutex<Vec<Scratch>>,
}

impl SoftwareRasteriser {
    /// A rasteriser that knows no object yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Renders one view with any shader.
    ///
    /// # Errors
    /// As [`Rasteriser::render`].
    pub fn render_with<S: Shader>(&self, index: usize, view: &View, shader: &S) -> Result<Rendering, RasterError> {
        check_view(index, view)?;
        let mesh = self.objects.get(&view.object_id).ok_or_else(|| RasterError::UnknownObject {
            object_id: view.object_id,
            known: self.objects.keys().copied().collect(),
        })?;
        let scene = Scene {
            items: &[Item { mesh, camera_from_object: view.camera_from_object }],
            intrinsics: view.intrinsics,
            width: view.width,
            height: view.height,
            background: Background::Colour([BACKGROUND_GREY; 3]),
        };
        let mut scratch = self.scratch.lock().ok().and_then(|mut pool| pool.pop()).unwrap_or_default();
        let mut out = Rendering::new(view.width, view.height);
        render_scene(&scene, shader, &mut scratch, &mut out);
        if let Ok(mut pool) = self.scratch.lock() {
            pool.push(scratch);
        }
        Ok(out)
    }
}

impl Rasteriser for SoftwareRasteriser {
    fn name(&self) -> String {
        "software rasteriser (CPU)".to_owned()
    }

    fn add_object(&mut self, object_id: u32, mesh: &Arc<Mesh>) -> Result<(), RasterError> {
        self.objects.insert(object_id, Arc::clone(mesh));
        Ok(())
    }

    fn render(&self, views: &[View]) -> Result<Vec<Rendering>, RasterError> {
        let one = |(i, view)| self.render_with(i, view, &Headlight::default());
        match views.len() {
            1 => Ok(vec![one((0, &views[0]))?]),
            _ => views.par_iter().enumerate().map(one).collect(),
        }
    }
}
