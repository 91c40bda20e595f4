use crate::layout::{Length, MalformedMessage, Reader, Writer};
use crate::{Message, ObjectPose};
use bytemuck::{Pod, Zeroable};
use std::collections::BTreeSet;

/// What stands before the views.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct ReferenceViewsHeader {
    /// Objects (instances) in the frame that have views.
    pub instances: u32,
    /// Rendered views of each.
    pub views_per_instance: u32,
    /// Width and height of crops and renderings, pixels.
    pub size_px: u32,
    /// BOP scene of the frame.
    pub scene_id: u32,
    /// BOP image of the frame.
    pub image_id: u32,
    /// Objects whose crop could not be made; they stand in `skipped`.
    pub skipped: u32,
    /// Crops of other frames that go with each instance (training; else 0).
    pub partners_per_instance: u32,
    /// Zero.
    pub reserved: u32,
}

/// Another frame that shows the object from nearly the same side: a partner of the photometric loss (method.md).
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
pub struct Partner {
    /// BOP scene of the other frame.
    pub scene_id: u32,
    /// BOP image of the other frame.
    pub image_id: u32,
    /// 1 when there is one, 0 when too few frames are near.
    pub present: u32,
    /// Zero.
    pub reserved: u32,
}

/// One rendering: which object, seen how.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct ReferenceView {
    /// The pose that was rendered (view 0: the initial pose itself, as it came in).
    pub pose: ObjectPose,
    /// The crop's K': fx, fy, cx, cy in crop pixels. The same for all views of an instance.
    pub crop_intrinsics: [f64; 4],
    /// The crop in the image: x0, y0 (edges), side, in image pixels.
    pub crop: [f64; 3],
    /// Diameter of the object, metres.
    pub diameter_m: f64,
}

/// For each object of a frame: the real crop and `n` renderings at and around its initial pose; for training also
/// the crops of `m` partners.
///
/// Producer: renderer. Consumers: flow, pnp, judge, consistency, trainer. Instance i owns views `i n .. (i + 1) n` and
/// partners `i m .. (i + 1) m`.
#[derive(Debug, Clone, Copy)]
pub struct ReferenceViews<'a> {
    /// Counts and size.
    pub header: &'a ReferenceViewsHeader,
    /// `instances x n`.
    pub views: &'a [ReferenceView],
    /// Initial poses that got no views, with their reason as status.
    pub skipped: &'a [ObjectPose],
    /// `instances x m`.
    pub partners: &'a [Partner],
    /// The real crops: `instances x S x S x 3`, RGB.
    pub real_rgb: &'a [u8],
    /// The partners' crops around their own initial poses: `instances x m x S x S x 3`, RGB, 0 where absent.
    pub partner_rgb: &'a [u8],
    /// The renderings: `instances x n x S x S x 3`, RGB.
    pub rgb: &'a [u8],
    /// Depth along z of the renderings, metres, 0 where there is no object: `instances x n x S x S`.
    pub depth_m: &'a [f32],
    /// 255 on the object, 0 elsewhere: `instances x n x S x S`.
    pub mask: &'a [u8],
}

/// [`ReferenceViews`] being written; the fields are those of the message.
#[derive(Debug)]
#[allow(missing_docs, reason = "the fields are those of ReferenceViews")]
pub struct ReferenceViewsMut<'a> {
    pub views: &'a mut [ReferenceView],
    pub skipped: &'a mut [ObjectPose],
    pub partners: &'a mut [Partner],
    pub real_rgb: &'a mut [u8],
    pub partner_rgb: &'a mut [u8],
    pub rgb: &'a mut [u8],
    pub depth_m: &'a mut [f32],
    pub mask: &'a mut [u8],
}

struct Counts {
    instances: usize,
    views: usize,
    skipped: usize,
    partners: usize,
    pixels: usize,
}

impl From<&ReferenceViewsHeader> for Counts {
    fn from(header: &ReferenceViewsHeader) -> Self {
        let instances = header.instances as usize;
        Self {
            instances,
            views: instances * header.views_per_instance as usize,
            skipped: header.skipped as usize,
            partners: instances * header.partners_per_instance as usize,
            pixels: (header.size_px as usize).pow(2),
        }
    }
}

impl ReferenceViews<'_> {
    /// Bytes of a message with this header.
    #[must_use]
    pub fn byte_len(header: &ReferenceViewsHeader) -> usize {
        let n = Counts::from(header);
        Length::default()
            .and::<ReferenceViewsHeader>(1)
            .and::<ReferenceView>(n.views)
            .and::<ObjectPose>(n.skipped)
            .and::<Partner>(n.partners)
            .and::<u8>(n.instances * n.pixels * 3)
            .and::<u8>(n.partners * n.pixels * 3)
            .and::<u8>(n.views * n.pixels * 3)
            .and::<f32>(n.views * n.pixels)
            .and::<u8>(n.views * n.pixels)
            .bytes()
    }

    /// Objects that the views show, each instance once, whatever the number of its hypotheses.
    #[must_use]
    pub fn objects(&self) -> usize {
        let instances: BTreeSet<_> = self.views.iter().map(|view| view.pose.identity()).collect();
        instances.len()
    }

    /// Writes the header and hands out the rest.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], header: ReferenceViewsHeader) -> ReferenceViewsMut<'_> {
        let n = Counts::from(&header);
        let mut writer = Writer::new(bytes);
        writer.one(header);
        ReferenceViewsMut {
            views: writer.array(n.views),
            skipped: writer.array(n.skipped),
            partners: writer.array(n.partners),
            real_rgb: writer.array(n.instances * n.pixels * 3),
            partner_rgb: writer.array(n.partners * n.pixels * 3),
            rgb: writer.array(n.views * n.pixels * 3),
            depth_m: writer.array(n.views * n.pixels),
            mask: writer.array(n.views * n.pixels),
        }
    }
}

impl Message for ReferenceViews<'static> {
    const TYPE_NAME: &'static str = "ReferenceViews@2";
    type View<'a> = ReferenceViews<'a>;

    fn view(bytes: &[u8]) -> Result<ReferenceViews<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<ReferenceViewsHeader>("header")?;
        let n = Counts::from(header);
        Ok(ReferenceViews {
            header,
            views: reader.array("views", n.views)?,
            skipped: reader.array("skipped", n.skipped)?,
            partners: reader.array("partners", n.partners)?,
            real_rgb: reader.array("real_rgb", n.instances * n.pixels * 3)?,
            partner_rgb: reader.array("partner_rgb", n.partners * n.pixels * 3)?,
            rgb: reader.array("rgb", n.views * n.pixels * 3)?,
            depth_m: reader.array("depth_m", n.views * n.pixels)?,
            mask: reader.array("mask", n.views * n.pixels)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn sections_do_not_overlap() {
        let header = ReferenceViewsHeader {
            instances: 2,
            views_per_instance: 3,
            size_px: 5,
            scene_id: 0,
            image_id: 0,
            skipped: 1,
            partners_per_instance: 2,
            reserved: 0,
        };
        let mut bytes = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
        let message = ReferenceViews::write(&mut bytes, header);
        message.real_rgb.fill(1);
        message.partner_rgb.fill(5);
        message.rgb.fill(2);
        message.depth_m.fill(3.0);
        message.mask.fill(4);
        let read = ReferenceViews::view(&bytes).unwrap();
        assert_eq!((read.views.len(), read.skipped.len()), (6, 1));
        assert!(read.real_rgb.len() == 150 && read.real_rgb.iter().all(|v| *v == 1));
        assert!(read.partners.len() == 4 && read.partner_rgb.len() == 300);
        assert!(read.partner_rgb.iter().all(|v| *v == 5));
        assert!(read.rgb.len() == 450 && read.rgb.iter().all(|v| *v == 2));
        assert!(read.depth_m.len() == 150 && read.depth_m.iter().all(|v| *v == 3.0));
        assert!(read.mask.len() == 150 && read.mask.iter().all(|v| *v == 4));
    }

    #[test]
    fn hypotheses_of_an_instance_count_as_one_object() {
        let zeroed = ReferenceViewsHeader::zeroed();
        let header = ReferenceViewsHeader { instances: 4, views_per_instance: 1, size_px: 1, ..zeroed };
        let mut bytes = AlignedBytes::zeroed(ReferenceViews::byte_len(&header));
        let message = ReferenceViews::write(&mut bytes, header);
        for (view, (object_id, instance)) in message.views.iter_mut().zip([(1, 0), (1, 0), (1, 1), (2, 0)]) {
            (view.pose.object_id, view.pose.instance) = (object_id, instance);
        }
        assert_eq!(ReferenceViews::view(&bytes).unwrap().objects(), 3);
    }
}
