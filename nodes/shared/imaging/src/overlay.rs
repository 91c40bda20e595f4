use crate::raster::{RasterError, Rasteriser, View};
use crate::{BACKGROUND_GREY, RgbImage};
use image::Rgb;
use pseudoflow_geometry::{Intrinsics, Pose};

/// The contour colour of initial poses: red.
pub const INITIAL_COLOUR: [u8; 3] = [255, 40, 30];
/// The contour colour of refined poses: green.
pub const REFINED_COLOUR: [u8; 3] = [30, 230, 60];

/// Draws the outline of a mask (row-major, the image's size, not 0 inside) on the image: the pixels inside the mask
/// with a neighbour outside, and those within `width_px - 1` around them.
pub fn draw_contour(image: &mut RgbImage, mask: &[u8], colour: [u8; 3], width_px: u32) {
    let (width, height) = (i64::from(image.width()), i64::from(image.height()));
    let inside = |x: i64, y: i64| {
        let within = (0..width).contains(&x) && (0..height).contains(&y);
        within && mask.get((y * width + x) as usize).is_some_and(|m| *m != 0)
    };
    let reach = i64::from(width_px.max(1)) - 1;
    for y in 0..height {
        for x in 0..width {
            let neighbours = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)];
            if !inside(x, y) || neighbours.iter().all(|&(x, y)| inside(x, y)) {
                continue;
            }
            for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
                let (x, y) = (x + dx, y + dy);
                if dx * dx + dy * dy <= reach * reach && (0..width).contains(&x) && (0..height).contains(&y) {
                    image.put_pixel(x as u32, y as u32, Rgb(colour));
                }
            }
        }
    }
}

/// Draws the outline of an object at a pose on a whole frame.
///
/// # Errors
/// As [`Rasteriser::render`].
pub fn draw_pose_contour(
    image: &mut RgbImage,
    rasteriser: &dyn Rasteriser,
    object_id: u32,
    camera_from_object: &Pose,
    intrinsics: &Intrinsics,
    colour: [u8; 3],
) -> Result<(), RasterError> {
    let view = View {
        object_id,
        camera_from_object: *camera_from_object,
        intrinsics: *intrinsics,
        width: image.width(),
        height: image.height(),
    };
    for rendering in rasteriser.render(&[view])? {
        draw_contour(image, &rendering.mask, colour, 1);
    }
    Ok(())
}

/// Two images beside each other, aligned at the top, with a grey gap of 4 pixels.
#[must_use]
pub fn side_by_side(left: &RgbImage, right: &RgbImage) -> RgbImage {
    const GAP: u32 = 4;
    let size = (left.width() + GAP + right.width(), left.height().max(right.height()));
    let mut panel = RgbImage::from_pixel(size.0, size.1, Rgb([BACKGROUND_GREY; 3]));
    image::imageops::replace(&mut panel, left, 0, 0);
    image::imageops::replace(&mut panel, right, i64::from(left.width() + GAP), 0);
    panel
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_contour_is_the_rim_of_the_mask() {
        let mut image = RgbImage::new(8, 8);
        let mask: Vec<u8> = (0..64).map(|i| u8::from((2..6).contains(&(i % 8)) && (2..6).contains(&(i / 8)))).collect();
        draw_contour(&mut image, &mask, REFINED_COLOUR, 1);
        let drawn = image.pixels().filter(|p| p.0 == REFINED_COLOUR).count();
        assert_eq!(drawn, 12);
        assert_eq!(image.get_pixel(3, 3).0, [0; 3]);
        assert_eq!(image.get_pixel(2, 2).0, REFINED_COLOUR);
    }

    #[test]
    fn panels_keep_their_pixels() {
        let panel = side_by_side(&RgbImage::new(3, 5), &RgbImage::from_pixel(2, 4, Rgb([9; 3])));
        assert_eq!(panel.dimensions(), (9, 5));
        assert_eq!(panel.get_pixel(7, 3).0, [9; 3]);
        assert_eq!(panel.get_pixel(7, 4).0, [BACKGROUND_GREY; 3]);
    }
}
