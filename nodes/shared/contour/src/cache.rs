//! Contour models on disk, named by what they were made from.

use crate::ContourError;
use crate::model::{ContourModel, ContourPoint, ModelSettings};
use pseudoflow_imaging::Mesh;
use std::hash::Hasher;
use std::path::Path;

/// Changes whenever the same mesh gives other points.
const VERSION: u64 = 1;

/// FNV-1a over 64 bits: the same on every machine and with every compiler, as file names must be.
struct Fnv(u64);

impl Hasher for Fnv {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

/// What a model depends on: positions, faces and settings.
fn key(mesh: &Mesh, settings: &ModelSettings) -> u64 {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    hash.write_u64(VERSION);
    hash.write_u32(settings.divisions);
    hash.write_usize(settings.points);
    hash.write_u64(settings.distance.to_bits());
    hash.write_u32(settings.size_px);
    hash.write_u8(u8::from(mesh.closed));
    hash.write(bytemuck::cast_slice(&mesh.vertices_m));
    hash.write(bytemuck::cast_slice(&mesh.triangles));
    hash.finish()
}

/// The model of a mesh from `folder`, made and kept there when it is not there yet. A damaged file is made anew.
///
/// # Errors
/// [`ContourError::Mesh`] as [`ContourModel::new`]; [`ContourError::Cache`] when the folder cannot be written.
pub fn load_or_make(mesh: &Mesh, settings: &ModelSettings, folder: &Path) -> Result<ContourModel, ContourError> {
    let path = folder.join(format!("{:016x}.contour", key(mesh, settings)));
    if let Some(model) = std::fs::read(&path).ok().and_then(|bytes| decode(&bytes)) {
        return Ok(model);
    }
    let model = ContourModel::new(mesh, settings)?;
    keep(&model, &path).map_err(|source| ContourError::Cache { path, source })?;
    Ok(model)
}

fn keep(model: &ContourModel, path: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
    pseudoflow_files::write(path, &encode(model))
}

const MAGIC: &[u8; 8] = b"pfcont01";

/// Magic, checksum, counts of views and points, middle and radius, directions, starts, points; little-endian.
fn encode(model: &ContourModel) -> Vec<u8> {
    let mut body = Vec::new();
    body.extend((model.directions.len() as u32).to_le_bytes());
    body.extend((model.points.len() as u32).to_le_bytes());
    body.extend(model.centre_m.iter().chain([&model.radius_m]).flat_map(|v| v.to_le_bytes()));
    body.extend(model.directions.iter().flatten().flat_map(|v| v.to_le_bytes()));
    body.extend(model.starts.iter().flat_map(|v| v.to_le_bytes()));
    body.extend_from_slice(bytemuck::cast_slice(&model.points));
    let mut out = MAGIC.to_vec();
    out.extend(checksum(&body).to_le_bytes());
    out.extend(body);
    out
}

fn checksum(bytes: &[u8]) -> u64 {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    hash.write(bytes);
    hash.finish()
}

fn decode(bytes: &[u8]) -> Option<ContourModel> {
    let (magic, rest) = bytes.split_at_checked(8)?;
    let (sum, body) = rest.split_at_checked(8)?;
    if magic != MAGIC || u64::from_le_bytes(sum.try_into().ok()?) != checksum(body) {
        return None;
    }
    let mut words = body.as_chunks::<4>().0.iter().copied();
    let (views, points) = (u32::from_le_bytes(words.next()?) as usize, u32::from_le_bytes(words.next()?) as usize);
    let mut number = || words.next().map(f32::from_le_bytes);
    let (centre_m, radius_m) = ([number()?, number()?, number()?], number()?);
    let directions = (0..views).map(|_| Some([number()?, number()?, number()?])).collect::<Option<Vec<_>>>()?;
    let starts = (0..=views).map(|_| words.next().map(u32::from_le_bytes)).collect::<Option<Vec<_>>>()?;
    let rest: Vec<[u8; 4]> = words.collect();
    let points = (rest.len() * 4 == points * size_of::<ContourPoint>()).then(|| {
        let floats: Vec<f32> = rest.into_iter().map(f32::from_le_bytes).collect();
        bytemuck::cast_slice(&floats).to_vec()
    })?;
    Some(ContourModel { directions, starts, points, centre_m, radius_m })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_imaging::shapes::cuboid;

    const FEW: ModelSettings = ModelSettings { divisions: 0, points: 50, distance: 5.0, size_px: 120 };

    #[test]
    fn a_model_is_read_back_as_it_was_made() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = cuboid([0.1, 0.05, 0.03], [9; 3]).unwrap();
        let made = load_or_make(&mesh, &FEW, folder.path()).unwrap();
        let files = || std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path()).collect::<Vec<_>>();
        assert_eq!(files().len(), 1);
        assert_eq!(decode(&std::fs::read(&files()[0]).unwrap()).unwrap(), made);
        assert_eq!(load_or_make(&mesh, &FEW, folder.path()).unwrap(), made);
        let other = cuboid([0.1, 0.05, 0.031], [9; 3]).unwrap();
        load_or_make(&other, &FEW, folder.path()).unwrap();
        assert_eq!(files().len(), 2, "another mesh, another file");
    }

    #[test]
    fn a_damaged_file_is_made_anew() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = cuboid([0.1, 0.05, 0.03], [9; 3]).unwrap();
        let made = load_or_make(&mesh, &FEW, folder.path()).unwrap();
        let path = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        let good = std::fs::read(&path).unwrap();
        for damaged in [&good[..good.len() - 7], &[&good[..99], &[good[99] ^ 4], &good[100..]].concat(), &[]] {
            std::fs::write(&path, damaged).unwrap();
            assert_eq!(load_or_make(&mesh, &FEW, folder.path()).unwrap(), made);
            assert_eq!(std::fs::read(&path).unwrap(), good);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let mesh = cuboid([0.1, 0.05, 0.03], [9; 3]).unwrap();
        let error = load_or_make(&mesh, &FEW, Path::new("/proc/nowhere")).unwrap_err().to_string();
        assert!(error.contains("/proc/nowhere"), "{error}");
    }
}
