use crate::{ImagingError, RgbImage, Texture, normals};
use nalgebra::Point3;
use std::path::Path;

/// A triangle mesh in the object's frame, ready to render.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// Positions, metres.
    pub vertices_m: Vec<[f32; 3]>,
    /// Unit normals, one per vertex.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, one per vertex, or empty. u to the right, v up (OpenGL): `(0, 0)` is the lower left corner.
    pub texcoords: Vec<[f32; 2]>,
    /// sRGB colours, one per vertex, or empty. With neither texture nor colours the mesh is light grey.
    pub colours: Vec<[u8; 3]>,
    /// Share of the surroundings that each vertex sees past the mesh itself, of 255 ([`crate::raster::openness`]); empty
    /// where nobody asked for it.
    pub openness: Vec<u8>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// The texture with its mip levels.
    pub texture: Option<Texture>,
    /// Whether the surface is closed and consistently oriented, so that triangles seen from behind are hidden.
    pub closed: bool,
}

/// What a loader read; [`Mesh::new`] checks it.
#[derive(Debug, Clone, Default)]
pub struct MeshParts {
    /// Positions, metres.
    pub vertices_m: Vec<[f32; 3]>,
    /// Normals of any length, or empty (then computed).
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates or empty.
    pub texcoords: Vec<[f32; 2]>,
    /// Colours or empty.
    pub colours: Vec<[u8; 3]>,
    /// Vertex indices.
    pub triangles: Vec<[u32; 3]>,
    /// The texture image.
    pub texture: Option<RgbImage>,
}

impl Mesh {
    /// Checks the parts and completes them: missing normals, triangle orientation, mip levels. `origin` (a path)
    /// names the mesh in errors.
    ///
    /// # Errors
    /// No faces, numbers that are not finite, indices out of range, attributes that are not one per vertex.
    pub fn new(parts: MeshParts, origin: &Path) -> Result<Self, ImagingError> {
        check(&parts, origin)?;
        let MeshParts { vertices_m, normals, texcoords, colours, mut triangles, texture } = parts;
        let topology = normals::Topology::of(&vertices_m, &triangles);
        if topology.inside_out {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let normals = match normals.is_empty() || topology.inside_out {
            true => normals::smooth(&vertices_m, &triangles, &topology.welded),
            false => normals::normalised(&normals, &vertices_m, &triangles, &topology.welded),
        };
        let texture = texture.filter(|_| !texcoords.is_empty()).map(|t| Texture::new(&t, &texcoords, &triangles));
        let (openness, closed) = (Vec::new(), topology.closed);
        Ok(Self { vertices_m, normals, texcoords, colours, openness, triangles, texture, closed })
    }

    /// The positions as points, metres.
    #[must_use]
    pub fn points(&self) -> Vec<Point3<f64>> {
        self.vertices_m.iter().map(|v| Point3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))).collect()
    }

    /// The lowest and highest corner of the axis-aligned bounding box, metres.
    #[must_use]
    pub fn bounds_m(&self) -> (Point3<f64>, Point3<f64>) {
        let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
        for v in &self.vertices_m {
            for k in 0..3 {
                (low[k], high[k]) = (low[k].min(v[k]), high[k].max(v[k]));
            }
        }
        (low.map(f64::from).into(), high.map(f64::from).into())
    }

    /// The corners of that box, metres.
    #[must_use]
    pub fn box_corners_m(&self) -> [Point3<f64>; 8] {
        let (low, high) = self.bounds_m();
        std::array::from_fn(|i| Point3::from([0, 1, 2].map(|k| if i >> k & 1 == 1 { high[k] } else { low[k] })))
    }

    /// A subset of the vertices that bounds the projection from every side: the extreme vertex in each of 1024
    /// directions spread evenly over the sphere, in the order of their index. What sticks out between two
    /// directions is under 0.1 % of the diameter.
    #[must_use]
    pub fn hull_points(&self) -> Vec<Point3<f64>> {
        const DIRECTIONS: usize = 1024;
        let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
        let mut chosen: Vec<usize> = (0..DIRECTIONS)
            .map(|i| {
                let z = 1.0 - (2.0 * i as f64 + 1.0) / DIRECTIONS as f64;
                let (radius, angle) = ((1.0 - z * z).sqrt(), golden * i as f64);
                self.extreme_vertex([(radius * angle.cos()) as f32, (radius * angle.sin()) as f32, z as f32])
            })
            .collect();
        chosen.sort_unstable();
        chosen.dedup();
        let points = chosen.iter().map(|&i| self.vertices_m[i].map(f64::from).into());
        points.collect()
    }

    fn extreme_vertex(&self, d: [f32; 3]) -> usize {
        let along = |v: &[f32; 3]| d[0] * v[0] + d[1] * v[1] + d[2] * v[2];
        let (mut best, mut best_value) = (0, f32::MIN);
        for (i, v) in self.vertices_m.iter().enumerate() {
            let value = along(v);
            if value > best_value {
                (best, best_value) = (i, value);
            }
        }
        best
    }

    /// The largest distance between two vertices, metres (between the points of [`Mesh::hull_points`]).
    #[must_use]
    pub fn diameter_m(&self) -> f64 {
        let hull = self.hull_points();
        let pairs =
            hull.iter().enumerate().flat_map(|(i, a)| hull[i + 1..].iter().map(move |b| (a - b).norm_squared()));
        pairs.fold(0.0, f64::max).sqrt()
    }
}

fn check(parts: &MeshParts, origin: &Path) -> Result<(), ImagingError> {
    let path = || origin.to_owned();
    let count = parts.vertices_m.len();
    if parts.triangles.is_empty() {
        return Err(ImagingError::NoFaces { path: path() });
    }
    let not_finite = |field, index: Option<usize>| match index {
        Some(index) => Err(ImagingError::NotFinite { path: path(), field, index }),
        None => Ok(()),
    };
    not_finite("x, y, z", parts.vertices_m.iter().position(|v| v.iter().any(|c| !c.is_finite())))?;
    not_finite("texture_u, texture_v", parts.texcoords.iter().position(|v| v.iter().any(|c| !c.is_finite())))?;
    for (face, triangle) in parts.triangles.iter().enumerate() {
        if let Some(&index) = triangle.iter().find(|&&i| i as usize >= count) {
            return Err(ImagingError::IndexRange { path: path(), face, index: i64::from(index), vertices: count });
        }
    }
    let lengths =
        [("normals", parts.normals.len()), ("texcoords", parts.texcoords.len()), ("colours", parts.colours.len())];
    match lengths.iter().find(|(_, n)| *n != 0 && *n != count) {
        Some((field, n)) => {
            let what = format!("{n} values for {count} vertices");
            Err(ImagingError::field(origin, *field, what, "give one per vertex or none"))
        }
        None => Ok(()),
    }
}
