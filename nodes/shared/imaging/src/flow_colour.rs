use crate::RgbImage;
use image::Rgb;

/// Colours a flow field: the hue says the direction, the saturation the length (colour wheel of Baker et al., "A
/// Database and Evaluation Methodology for Optical Flow", IJCV 2011). `flow_px` is row-major `height x width` of
/// (dx, dy), pixels; vectors of `max_px` or longer are saturated; NaN is black.
#[must_use]
pub fn flow_to_colour(flow_px: &[[f32; 2]], width: u32, height: u32, max_px: f32) -> RgbImage {
    let wheel = wheel();
    RgbImage::from_fn(width, height, |x, y| {
        let flow = flow_px.get((y * width + x) as usize).copied().unwrap_or([f32::NAN; 2]);
        Rgb(wheel_colour(&wheel, [flow[0] / max_px, flow[1] / max_px]))
    })
}

/// The wheel's 55 colours: six transitions between red, yellow, green, cyan, blue and magenta of unequal length.
fn wheel() -> Vec<[f32; 3]> {
    const STEPS: [(usize, [f32; 3], [f32; 3]); 6] = [
        (15, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
        (6, [1.0, 1.0, 0.0], [-1.0, 0.0, 0.0]),
        (4, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
        (11, [0.0, 1.0, 1.0], [0.0, -1.0, 0.0]),
        (13, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]),
        (6, [1.0, 0.0, 1.0], [0.0, 0.0, -1.0]),
    ];
    let blend = |n: usize, from: [f32; 3], step: [f32; 3]| {
        (0..n).map(move |i| std::array::from_fn(|k| from[k] + step[k] * i as f32 / n as f32))
    };
    STEPS.iter().flat_map(|&(n, from, step)| blend(n, from, step)).collect()
}

fn wheel_colour(wheel: &[[f32; 3]], flow: [f32; 2]) -> [u8; 3] {
    let length = flow[0].hypot(flow[1]);
    if !length.is_finite() {
        return [0; 3];
    }
    let turn = ((-flow[1]).atan2(-flow[0]) / std::f32::consts::PI + 1.0) / 2.0;
    let place = turn * (wheel.len() - 1) as f32;
    let (low, t) = (place as usize, place.fract());
    let (a, b) = (wheel[low % wheel.len()], wheel[(low + 1) % wheel.len()]);
    std::array::from_fn(|k| {
        let hue = a[k] + t * (b[k] - a[k]);
        let value = if length <= 1.0 { 1.0 - length * (1.0 - hue) } else { 0.75 * hue };
        (255.0 * value) as u8
    })
}

/// Colours a scalar field from black over red and yellow to white; `values` is row-major `height x width`, `low` and
/// `high` are the ends of the scale; NaN is blue.
#[must_use]
pub fn heat_map(values: &[f32], width: u32, height: u32, low: f32, high: f32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let value = values.get((y * width + x) as usize).copied().unwrap_or(f32::NAN);
        if value.is_nan() {
            return Rgb([0, 0, 255]);
        }
        let t = 3.0 * ((value - low) / (high - low)).clamp(0.0, 1.0);
        Rgb([0.0, 1.0, 2.0].map(|start: f32| (255.0 * (t - start).clamp(0.0, 1.0)) as u8))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_flow_is_white_and_opposite_flows_differ() {
        let image = flow_to_colour(&[[0.0, 0.0], [5.0, 0.0], [-5.0, 0.0], [f32::NAN, 0.0]], 4, 1, 5.0);
        assert_eq!(image.get_pixel(0, 0).0, [255; 3]);
        assert_eq!(image.get_pixel(1, 0).0, [255, 0, 0], "to the right is red");
        assert!(image.get_pixel(2, 0)[0] < 30 && image.get_pixel(2, 0)[2] == 255, "to the left is blue");
        assert_eq!(image.get_pixel(3, 0).0, [0; 3]);
    }

    #[test]
    fn heat_rises_from_black_to_white() {
        let image = heat_map(&[0.0, 1.0, 3.0, f32::NAN], 4, 1, 0.0, 3.0);
        let pixels: Vec<[u8; 3]> = image.pixels().map(|p| p.0).collect();
        assert_eq!(pixels, [[0, 0, 0], [255, 0, 0], [255, 255, 255], [0, 0, 255]]);
    }
}
