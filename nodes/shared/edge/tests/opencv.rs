//! Lenses and pixels beside OpenCV's: golden values of `tests/compare/camera_vs_opencv.py`.

use pseudoflow_edge::camera::Lens;
use pseudoflow_edge::pixels::write_rgb;
use pseudoflow_msgs::ros::{CameraInfo, Image};
use serde_json::Value;

fn golden() -> Value {
    serde_json::from_str(include_str!("opencv.json")).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

#[test]
fn maps_are_within_a_hundredth_of_a_pixel() {
    let golden = &golden()["camera"];
    let (k, p, r) = (numbers(&golden["k"]), numbers(&golden["p"]), numbers(&golden["r"]));
    for lens in golden["lenses"].as_array().unwrap() {
        let info = CameraInfo {
            width: 640,
            height: 480,
            distortion_model: lens["model"].as_str().unwrap().into(),
            d: numbers(&lens["d"]),
            k: k.clone().try_into().unwrap(),
            r: r.clone().try_into().unwrap(),
            p: [p[0], 0.0, p[2], 0.0, 0.0, p[4], p[5], 0.0, 0.0, 0.0, 1.0, 0.0],
            ..CameraInfo::default()
        };
        let made = Lens::new(&info, (640, 480), false).unwrap();
        for (pixel, source) in lens["pixels"].as_array().unwrap().iter().zip(lens["source"].as_array().unwrap()) {
            let (pixel, source) = (numbers(pixel), numbers(source));
            let found = made.source([pixel[0], pixel[1]]).unwrap();
            let off = (found[0] - source[0]).hypot(found[1] - source[1]);
            assert!(off < 0.01, "{} {pixel:?}: {found:?}, OpenCV {source:?}", lens["model"]);
        }
    }
}

fn bytes(value: &Value) -> Vec<u8> {
    let text = value.as_str().unwrap();
    (0..text.len()).step_by(2).map(|i| u8::from_str_radix(&text[i..i + 2], 16).unwrap()).collect()
}

#[test]
fn every_encoding_is_within_a_grey_level() {
    let golden = golden();
    let images = golden["pixels"].as_array().unwrap();
    assert_eq!(images.len(), 13);
    for image in images {
        let number = |key: &str| image[key].as_u64().unwrap() as u32;
        let encoding = image["encoding"].as_str().unwrap();
        let message = Image {
            width: number("width"),
            height: number("height"),
            step: number("step"),
            encoding: encoding.into(),
            data: bytes(&image["data"]),
            ..Image::default()
        };
        let mut rgb = Vec::new();
        write_rgb(&message, &mut rgb).unwrap();
        let off: Vec<u32> = rgb.iter().zip(bytes(&image["rgb"])).map(|(a, b)| u32::from(a.abs_diff(b))).collect();
        let mean = off.iter().sum::<u32>() as f64 / off.len() as f64;
        let worst = off.iter().max().unwrap();
        let good = if encoding.starts_with("bayer") { mean < 2.0 } else { *worst <= 1 };
        assert!(good && rgb.len() == 24 * 16 * 3, "{encoding}: mean {mean}, worst {worst}");
    }
}
