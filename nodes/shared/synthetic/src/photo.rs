//! Photographs: what lies behind and on tables and things.

use super::card::{Origin, Statements};
use super::random::Draw;
use crate::SyntheticError;
use pseudoflow_imaging::{RgbImage, load_rgb};
use rand::Rng;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A photograph with its mip levels, each half as wide and high. Beyond its border it goes on mirrored.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Photo {
    levels: Vec<Level>,
}

#[derive(Debug, Clone, PartialEq)]
struct Level {
    width: usize,
    height: usize,
    data: Vec<[u8; 3]>,
}

/// Photographs are halved until no side is longer, pixels.
const LONGEST_PX: usize = 640;
/// Photographs with a shorter side than this, or with hardly any variation, are not usable.
const SHORTEST_PX: u32 = 64;
/// Most photographs that are kept; of more, every n-th is taken.
const MOST: usize = 600;

impl Photo {
    /// Halves it to at most [`LONGEST_PX`] and builds the levels.
    pub(super) fn new(image: &RgbImage) -> Self {
        let data = image.as_chunks::<3>().0.to_vec();
        let mut level = Level { width: image.width() as usize, height: image.height() as usize, data };
        while level.width.max(level.height) > LONGEST_PX {
            level = level.halved();
        }
        let mut levels = vec![level];
        while levels.last().is_some_and(|l| l.width.min(l.height) > 1) {
            let next = levels[levels.len() - 1].halved();
            levels.push(next);
        }
        Self { levels }
    }

    /// Width and height, pixels.
    pub(super) fn size_px(&self) -> [usize; 2] {
        [self.levels[0].width, self.levels[0].height]
    }

    /// The colour (sRGB, 0 to 1) at a place in its pixels, for a footprint of so many pixels: bilinear on the level whose
    /// pixels are about as large.
    pub(super) fn colour(&self, x: f32, y: f32, footprint_px: f32) -> [f32; 3] {
        let mut number = 0;
        let mut scale = 1.0_f32;
        while footprint_px * scale > 1.4 && number + 1 < self.levels.len() {
            (number, scale) = (number + 1, 0.5 * scale);
        }
        self.levels[number].bilinear((x + 0.5) * scale - 0.5, (y + 0.5) * scale - 0.5)
    }
}

impl Level {
    /// The mean of each 2 x 2 pixels; an odd last row or column is left out.
    fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            let row = |y: usize| &self.data[y.min(self.height - 1) * self.width..][..self.width];
            let (above, below) = (row(2 * y), row(2 * y + 1));
            if self.width == 1 {
                data.push(mean([above[0], above[0], below[0], below[0]]));
                continue;
            }
            let pairs = above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
            data.extend(pairs.map(|(a, b)| mean([a[0], a[1], b[0], b[1]])));
        }
        Self { width, height, data }
    }

    fn bilinear(&self, x: f32, y: f32) -> [f32; 3] {
        let (x0, tx) = whole(x);
        let (y0, ty) = whole(y);
        let (xa, xb) = neighbours(x0, self.width);
        let (ya, yb) = neighbours(y0, self.height);
        let rows = [ya, yb].map(|y| y * self.width);
        let [a, b, c, d] = [rows[0] + xa, rows[0] + xb, rows[1] + xa, rows[1] + xb].map(|i| self.data[i]);
        let weights = [(1.0 - tx) * (1.0 - ty), tx * (1.0 - ty), (1.0 - tx) * ty, tx * ty].map(|w| w / 255.0);
        std::array::from_fn(|k| {
            weights[0] * f32::from(a[k])
                + weights[1] * f32::from(b[k])
                + weights[2] * f32::from(c[k])
                + weights[3] * f32::from(d[k])
        })
    }
}

/// The whole number at or below, and what is left.
fn whole(v: f32) -> (i32, f32) {
    let towards_zero = v as i32;
    let below = towards_zero.saturating_sub(i32::from(towards_zero as f32 > v));
    (below, (v - below as f32).clamp(0.0, 1.0))
}

fn mean(four: [[u8; 3]; 4]) -> [u8; 3] {
    std::array::from_fn(|k| ((four.iter().map(|c| u32::from(c[k])).sum::<u32>() + 2) / 4) as u8)
}

/// The places of pixels i and i + 1.
fn neighbours(i: i32, size: usize) -> (usize, usize) {
    match usize::try_from(i) {
        Ok(inside) if inside + 1 < size => (inside, inside + 1),
        _ => (mirrored(i, size), mirrored(i.wrapping_add(1), size)),
    }
}

fn mirrored(i: i32, size: usize) -> usize {
    let i = i.rem_euclid(2 * size as i32) as usize;
    if i < size { i } else { 2 * size - 1 - i }
}

/// Photographs to draw from.
#[derive(Debug, Default)]
pub(super) struct PhotoBank {
    photos: Vec<Arc<Photo>>,
    origins: Vec<Origin>,
}

impl PhotoBank {
    /// Reads all pictures (.jpg, .jpeg, .png) in folders and the folders in them, in the order of their paths. Pictures that
    /// cannot be read or show nothing are left out and counted in the log.
    ///
    /// # Errors
    /// When a folder cannot be read or holds no usable picture.
    pub(super) fn load(folders: &[PathBuf], only_shippable: bool) -> Result<Self, SyntheticError> {
        let mut paths = Vec::new();
        for folder in folders {
            let (found, stated) = (pictures_in(folder)?, Statements::of_folder(folder)?);
            let origin = |path: PathBuf| {
                let name = path.strip_prefix(folder).unwrap_or(&path).display().to_string();
                (path, stated.origin(&name, &name))
            };
            let found: Vec<(PathBuf, Origin)> =
                found.into_iter().map(origin).filter(|(_, origin)| !only_shippable || origin.is_free()).collect();
            if found.is_empty() {
                return Err(SyntheticError::NoPictures { folder: folder.clone(), found: 0 });
            }
            paths.push((folder, found));
        }
        let total: usize = paths.iter().map(|(_, found)| found.len()).sum();
        let step = total.div_ceil(MOST).max(1);
        let mut bank = Self::default();
        for (folder, found) in paths {
            let chosen: Vec<(PathBuf, Origin)> = found.into_iter().step_by(step).collect();
            let read = |(path, origin): &(PathBuf, Origin)| {
                let image = load_rgb(path).ok().filter(is_usable)?;
                Some((Arc::new(Photo::new(&image)), origin.clone()))
            };
            let read: Vec<_> = chosen.par_iter().map(read).collect();
            let usable: Vec<_> = read.into_iter().flatten().collect();
            if usable.is_empty() {
                return Err(SyntheticError::NoPictures { folder: folder.clone(), found: chosen.len() });
            }
            if usable.len() < chosen.len() {
                log::warn!(
                    "{}: {} of {} pictures are not usable",
                    folder.display(),
                    chosen.len() - usable.len(),
                    chosen.len()
                );
            }
            log::info!("{}: {} pictures for backgrounds", folder.display(), usable.len());
            for (photo, origin) in usable {
                bank.photos.push(photo);
                bank.origins.push(origin);
            }
        }
        Ok(bank)
    }

    /// Where they come from.
    pub(super) fn origins(&self) -> &[Origin] {
        &self.origins
    }

    /// Any of them; `None` when there are none.
    pub(super) fn draw(&self, rng: &mut impl Rng) -> Option<&Arc<Photo>> {
        self.photos.get(rng.below(self.photos.len()))
    }
}

/// Large enough, and not all of one colour.
fn is_usable(image: &RgbImage) -> bool {
    let luma = |p: &[u8; 3]| i32::from(p[0]) + i32::from(p[1]) + i32::from(p[2]);
    let pixels = image.as_chunks::<3>().0;
    let (low, high) = pixels.iter().step_by(61).map(luma).fold((i32::MAX, 0), |(l, h), v| (l.min(v), h.max(v)));
    image.width().min(image.height()) >= SHORTEST_PX && high - low > 24
}

fn pictures_in(folder: &Path) -> Result<Vec<PathBuf>, SyntheticError> {
    let mut found = Vec::new();
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|e| e.map(|e| e.path())).collect())
        .map_err(|source| SyntheticError::Unreadable { path: folder.to_owned(), source })?;
    entries.sort();
    for path in entries {
        let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase).unwrap_or_default();
        if path.is_dir() {
            // Depth images and masks of a BOP scene show nothing of a room.
            let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
            if !["depth", "mask", "mask_visib"].contains(&name) {
                found.extend(pictures_in(&path)?);
            }
        } else if ["jpg", "jpeg", "png"].contains(&extension.as_str()) {
            found.push(path);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn ramp(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| Rgb([(x % 256) as u8, (y % 256) as u8, 7]))
    }

    #[test]
    fn pixels_are_read_in_place_and_the_border_is_mirrored() {
        let photo = Photo::new(&ramp(80, 60));
        let at = |x: f32, y: f32| photo.colour(x, y, 1.0).map(|c| c * 255.0);
        assert!((at(10.5, 20.25)[0] - 10.5).abs() < 1e-3 && (at(10.5, 20.25)[1] - 20.25).abs() < 1e-3);
        assert!((at(-3.0, 5.0)[0] - 2.0).abs() < 1e-3 && (at(82.0, 5.0)[0] - 77.0).abs() < 1e-3);
        // A coarse level shows the same place.
        let coarse = photo.colour(40.0, 30.0, 8.0).map(|c| c * 255.0);
        assert!((coarse[0] - 40.0).abs() < 1.5 && (coarse[1] - 30.0).abs() < 1.5, "{coarse:?}");
    }

    #[test]
    fn large_pictures_are_halved() {
        assert_eq!(Photo::new(&ramp(1500, 901)).size_px(), [375, 225]);
        assert_eq!(Photo::new(&ramp(640, 400)).size_px(), [640, 400]);
    }

    #[test]
    fn folders_without_usable_pictures_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let load = || PhotoBank::load(&[folder.path().to_owned()], false);
        assert!(load().unwrap_err().to_string().contains("no picture"));
        std::fs::write(folder.path().join("a.jpg"), b"not a picture").unwrap();
        RgbImage::from_pixel(100, 100, Rgb([9; 3])).save(folder.path().join("plain.png")).unwrap();
        assert!(load().unwrap_err().to_string().contains("none of 2"), "{}", load().unwrap_err());
        std::fs::create_dir_all(folder.path().join("rgb")).unwrap();
        ramp(100, 80).save(folder.path().join("rgb/000000.png")).unwrap();
        assert_eq!(load().unwrap().photos.len(), 1);
        assert!(PhotoBank::load(&[folder.path().join("none")], false).unwrap_err().to_string().contains("none"));
    }
}
