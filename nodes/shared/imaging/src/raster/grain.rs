//! Smooth noise over space, for materials.

/// Value noise in [-1, 1]: random values at the corners of a lattice of unit cells, smoothly interpolated.
pub(crate) fn value_noise(at: [f32; 3], seed: u32) -> f32 {
    let cell = at.map(f32::floor);
    let t: [f32; 3] = std::array::from_fn(|k| {
        let f = at[k] - cell[k];
        f * f * (3.0 - 2.0 * f)
    });
    let corner =
        |dx: i32, dy: i32, dz: i32| lattice(cell[0] as i32 + dx, cell[1] as i32 + dy, cell[2] as i32 + dz, seed);
    let mix = |a: f32, b: f32, t: f32| a + t * (b - a);
    let edge = |dy, dz| mix(corner(0, dy, dz), corner(1, dy, dz), t[0]);
    let face = |dz| mix(edge(0, dz), edge(1, dz), t[1]);
    mix(face(0), face(1), t[2])
}

fn lattice(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    let mut h = seed ^ (x as u32).wrapping_mul(0x9E37_79B1);
    for v in [y, z] {
        h = (h ^ (h >> 15)).wrapping_mul(0x85EB_CA77) ^ (v as u32).wrapping_mul(0xC2B2_AE3D);
    }
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h ^= h >> 15;
    h as f32 / (u32::MAX as f32 / 2.0) - 1.0
}
