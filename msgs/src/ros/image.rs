use super::Header;
use serde::{Deserialize, Serialize};

/// `sensor_msgs/Image`: an uncompressed image.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// When and where it was taken.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Pixels per row.
    pub width: u32,
    /// Layout of a pixel: `rgb8`, `bgr8`, `mono8`, ...
    pub encoding: String,
    /// Whether numbers of several bytes have the high byte first.
    pub is_bigendian: u8,
    /// Bytes per row, padding included.
    pub step: u32,
    /// `height x step` bytes.
    #[serde(with = "serde_bytes")]
    pub data: Vec<u8>,
}

super::ros_message!(Image, "sensor_msgs", "Image");

#[cfg(test)]
mod tests {
    use super::super::{from_cdr, to_cdr};
    use super::*;

    #[test]
    fn cdr_has_the_layout_of_the_msg_file() {
        let image = Image {
            header: Header { frame_id: "cam".into(), ..Header::default() },
            height: 1,
            width: 2,
            encoding: "mono8".into(),
            is_bigendian: 0,
            step: 2,
            data: vec![7, 9],
        };
        #[rustfmt::skip]
        let expected = [
            0, 1, 0, 0, // encapsulation
            0, 0, 0, 0, 0, 0, 0, 0, // stamp
            4, 0, 0, 0, b'c', b'a', b'm', 0, // frame_id
            1, 0, 0, 0, 2, 0, 0, 0, // height, width
            6, 0, 0, 0, b'm', b'o', b'n', b'o', b'8', 0, // encoding
            0, 0, // is_bigendian, padding
            2, 0, 0, 0, 2, 0, 0, 0, 7, 9, // step, data
        ];
        assert_eq!(to_cdr(&image).unwrap(), expected);
        assert_eq!(from_cdr::<Image>(&expected).unwrap(), image);
    }
}
