//! Encoded views on disk, named by what they were made from.

use super::views::View;
use nalgebra::{Quaternion, UnitQuaternion, Vector2};
use pseudoflow_imaging::Mesh;
use std::hash::Hasher;
use std::path::{Path, PathBuf};

/// Changes whenever the same things give other views.
const VERSION: u64 = 1;
const MAGIC: &[u8; 8] = b"pfviews1";

/// Eight bytes at a time by multiplying and folding, as FNV-1a does it with one: the same on every machine, as file names and
/// checksums must be.
pub(super) struct Digest(u64);

impl Digest {
    pub(super) fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Hasher for Digest {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<8>();
        let mut last = [0; 8];
        last[..rest.len()].copy_from_slice(rest);
        for word in words.iter().chain([&last, &(bytes.len() as u64).to_le_bytes()]) {
            let mixed = (self.0 ^ u64::from_le_bytes(*word)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            self.0 = mixed ^ (mixed >> 29);
        }
    }
}

/// Name of the views of an object: its mesh and colours, the turns it is seen in, and what encodes it (`encoder`).
pub(super) fn key(mesh: &Mesh, diameter_m: f64, rotations: &[UnitQuaternion<f64>], encoder: u64) -> u64 {
    let mut hash = Digest::new();
    hash.write_u64(VERSION);
    hash.write_u64(encoder);
    hash.write_u64(diameter_m.to_bits());
    rotations.iter().flat_map(|r| r.coords.iter()).for_each(|v| hash.write_u64(v.to_bits()));
    hash.write_u8(u8::from(mesh.closed));
    hash.write(bytemuck::cast_slice(&mesh.vertices_m));
    hash.write(bytemuck::cast_slice(&mesh.normals));
    hash.write(bytemuck::cast_slice(&mesh.texcoords));
    hash.write(bytemuck::cast_slice(&mesh.colours));
    hash.write(bytemuck::cast_slice(&mesh.triangles));
    if let Some(level) = mesh.texture.iter().flat_map(|texture| texture.levels()).next() {
        hash.write_u32(level.width);
        hash.write(bytemuck::cast_slice(&level.data));
    }
    hash.finish()
}

/// Where the views of this name are kept.
pub(super) fn path(folder: &Path, key: u64) -> PathBuf {
    folder.join(format!("{key:016x}.views"))
}

/// The folder where caches of this user are kept: `$XDG_CACHE_HOME`, else `~/.cache`, else the system's for temporary files.
pub(super) fn default_folder() -> PathBuf {
    let given = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let caches = given("XDG_CACHE_HOME").or_else(|| given("HOME").map(|home| home.join(".cache")));
    caches.unwrap_or_else(std::env::temp_dir).join("pseudoflow").join("views")
}

/// Reads the views of a file; `None` when there is none. A damaged one is said and made anew by the caller.
pub(super) fn load(path: &Path) -> Option<Vec<View>> {
    let bytes = std::fs::read(path).ok()?;
    let views = decode(&bytes);
    if views.is_none() {
        log::warn!("{}: damaged, or of another version: the views are rendered again", path.display());
    }
    views
}

/// Keeps views; a reader sees a whole file or none.
pub(super) fn keep(views: &[View], path: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
    pseudoflow_files::write(path, &encode(views))
}

/// Magic, checksum, then of each view: turn, shape, cells across, cells, and for each cell a scale and bytes.
fn encode(views: &[View]) -> Vec<u8> {
    let mut body = Vec::new();
    body.extend((views.len() as u32).to_le_bytes());
    for view in views {
        body.extend(view.rotation.coords.iter().chain(view.shape.iter()).flat_map(|v| v.to_le_bytes()));
        let channels = view.features.len() / view.cells.len().max(1);
        for number in [view.across as u32, view.cells.len() as u32, channels as u32] {
            body.extend(number.to_le_bytes());
        }
        for (cell, feature) in view.cells.iter().zip(view.features.chunks_exact(channels.max(1))) {
            let (scale, bytes) = packed(feature);
            body.extend([cell[0] as u8, cell[1] as u8]);
            body.extend(scale.to_le_bytes());
            body.extend(bytes.map(|b| b as u8));
        }
    }
    let mut out = MAGIC.to_vec();
    out.extend(checksum(&body).to_le_bytes());
    out.extend(body);
    out
}

fn checksum(bytes: &[u8]) -> u64 {
    let mut hash = Digest::new();
    hash.write(bytes);
    hash.finish()
}

/// A feature in bytes: its largest value, and each value as a share of it in 127ths.
fn packed(feature: &[f32]) -> (f32, impl Iterator<Item = i8> + '_) {
    let scale = feature.iter().fold(0.0_f32, |most, v| most.max(v.abs())).max(f32::MIN_POSITIVE);
    (scale, feature.iter().map(move |v| (v / scale * 127.0).round() as i8))
}

/// A feature as a file would give it back: what is searched with must not depend on whether it was kept.
pub(super) fn round(feature: &mut [f32]) {
    let (scale, bytes) = packed(feature);
    let bytes: Vec<i8> = bytes.collect();
    feature.iter_mut().zip(bytes).for_each(|(v, b)| *v = unpacked(scale, b));
}

fn unpacked(scale: f32, byte: i8) -> f32 {
    scale * f32::from(byte) / 127.0
}

/// Takes from the front of bytes.
struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }

    fn slice(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(taken)
    }

    fn count(&mut self) -> Option<usize> {
        self.take().map(|bytes| u32::from_le_bytes(bytes) as usize)
    }
}

fn decode(bytes: &[u8]) -> Option<Vec<View>> {
    let mut all = Cursor(bytes);
    let (magic, sum) = (all.take::<8>()?, u64::from_le_bytes(all.take()?));
    if &magic != MAGIC || sum != checksum(all.0) {
        return None;
    }
    let count = all.count()?;
    let views: Vec<View> = (0..count).map(|_| view(&mut all)).collect::<Option<_>>()?;
    all.0.is_empty().then_some(views)
}

fn view(from: &mut Cursor<'_>) -> Option<View> {
    let mut number = || from.take().map(f64::from_le_bytes);
    let (x, y, z, w) = (number()?, number()?, number()?, number()?);
    let shape = Vector2::new(number()?, number()?);
    let (across, count, channels) = (from.count()?, from.count()?, from.count()?);
    let (mut cells, mut features) = (Vec::with_capacity(count), Vec::with_capacity(count * channels));
    for _ in 0..count {
        let [cx, cy] = from.take::<2>()?;
        let scale = f32::from_le_bytes(from.take()?);
        cells.push([i32::from(cx), i32::from(cy)]);
        features.extend(from.slice(channels)?.iter().map(|b| unpacked(scale, *b as i8)));
    }
    // Unit as it was written: normalising again would change the last bit.
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
    Some(View { rotation, shape, across: across as i32, cells, features })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_imaging::shapes::cuboid;

    fn views() -> Vec<View> {
        let view = |i: u32| {
            let mut features: Vec<f32> = (0..3 * 8).map(|k| ((k * 7 + i) % 11) as f32 / 9.0 - 0.5).collect();
            features.chunks_exact_mut(8).for_each(round);
            View {
                rotation: UnitQuaternion::from_euler_angles(0.3 * f64::from(i), 0.1, -0.2),
                shape: Vector2::new(1.0, 0.7),
                across: 12,
                cells: vec![[1, 2], [3, 4], [11, 0]],
                features,
            }
        };
        (0..4).map(view).collect()
    }

    #[test]
    fn views_are_read_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = path(folder.path(), 7);
        assert!(load(&path).is_none());
        keep(&views(), &path).unwrap();
        assert!(load(&path).unwrap() == views());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside");
    }

    #[test]
    fn a_damaged_file_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = path(folder.path(), 7);
        keep(&views(), &path).unwrap();
        let good = std::fs::read(&path).unwrap();
        for damaged in [&good[..good.len() - 1], &[&good[..99], &[good[99] ^ 4], &good[100..]].concat(), &[]] {
            std::fs::write(&path, damaged).unwrap();
            assert!(load(&path).is_none());
        }
    }

    #[test]
    fn the_name_depends_on_mesh_turns_and_encoder() {
        let mesh = |side| cuboid([0.1, 0.05, side], [9; 3]).unwrap();
        let turns = [UnitQuaternion::identity(), UnitQuaternion::from_euler_angles(0.1, 0.0, 0.0)];
        let first = key(&mesh(0.03), 0.1, &turns, 1);
        assert_eq!(first, key(&mesh(0.03), 0.1, &turns, 1));
        for other in [
            key(&mesh(0.031), 0.1, &turns, 1),
            key(&mesh(0.03), 0.11, &turns, 1),
            key(&mesh(0.03), 0.1, &turns[..1], 1),
            key(&mesh(0.03), 0.1, &turns, 2),
        ] {
            assert_ne!(first, other);
        }
    }
}
