use crate::Message;
use crate::layout::{Length, MalformedMessage, Reader, Writer};
use bytemuck::{Pod, Zeroable};

/// One solution of pnp, and whether its gate took it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct GateDecision {
    /// Id of the object in its set.
    pub object_id: u32,
    /// Tells instances of one object apart.
    pub instance: u32,
    /// 1 where the refined pose was taken, else 0.
    pub accepted: u32,
    /// Keeps the size a multiple of 8.
    pub reserved: u32,
    /// Rotation of the pose that the refinement began from, `camera_from_object`, unit quaternion x, y, z, w.
    pub before_rotation_xyzw: [f64; 4],
    /// Its translation, metres.
    pub before_translation_m: [f64; 3],
    /// Rotation of the refined pose, taken or not.
    pub after_rotation_xyzw: [f64; 4],
    /// Its translation, metres.
    pub after_translation_m: [f64; 3],
    /// The solver's own covariance of the refined pose, row-major 6 x 6 (translation in m, then rotation in rad, camera axes), not
    /// scaled by what was learnt.
    pub solver_covariance: [f64; 36],
    /// What the decision was made from, by [`GateDecision::EVIDENCE`]; NaN where unknown.
    pub evidence: [f64; GateDecision::EVIDENCE.len()],
}

impl GateDecision {
    /// Names of [`GateDecision::evidence`]: the features of pnp's gate, and last the claimed probability that the refined pose is
    /// better.
    pub const EVIDENCE: [&'static str; 28] = [
        "inlier_ratio",
        "inlier_rms",
        "photometric_initial",
        "photometric_refined",
        "photometric_gain",
        "textured",
        "silhouette_initial",
        "silhouette_refined",
        "silhouette_gain",
        "displacement",
        "displacement_over_tenth",
        "rotation",
        "rotation_over20_deg",
        "depth_change",
        "depth_change_over_quarter",
        "share_in_view",
        "ln_translation_sigma",
        "ln_rotation_sigma",
        "ln_magnification",
        "contour_overlap",
        "contour_agreement",
        "flow_contour_distance",
        "contour_seen",
        "cost_per_line",
        "ln_object_px",
        "shift",
        "certainty",
        "better",
    ];
}

#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
struct Header {
    count: u64,
}

/// The gate's decisions of one frame, one for each pose that was solved.
///
/// Producer: pnp. Consumer: results.
#[derive(Debug, Clone, Copy)]
pub struct GateDecisions<'a> {
    /// The decisions.
    pub decisions: &'a [GateDecision],
}

impl GateDecisions<'_> {
    /// Bytes of a message of this many decisions.
    #[must_use]
    pub fn byte_len(count: usize) -> usize {
        Length::default().and::<Header>(1).and::<GateDecision>(count).bytes()
    }

    /// Writes a whole message.
    ///
    /// # Panics
    /// When `bytes` is shorter than [`Self::byte_len`] or not aligned to 64 bytes.
    pub fn write(bytes: &mut [u8], decisions: &[GateDecision]) {
        let mut writer = Writer::new(bytes);
        writer.one(Header { count: decisions.len() as u64 });
        writer.array::<GateDecision>(decisions.len()).copy_from_slice(decisions);
    }
}

impl Message for GateDecisions<'static> {
    const TYPE_NAME: &'static str = "GateDecisions@2";
    type View<'a> = GateDecisions<'a>;

    fn view(bytes: &[u8]) -> Result<GateDecisions<'_>, MalformedMessage> {
        let mut reader = Reader::new(Self::TYPE_NAME, bytes)?;
        let header = reader.one::<Header>("header")?;
        let count = usize::try_from(header.count).unwrap_or(usize::MAX);
        Ok(GateDecisions { decisions: reader.array::<GateDecision>("decisions", count)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AlignedBytes;

    #[test]
    fn decisions_round_trip_and_a_cut_message_is_refused() {
        let one = GateDecision { object_id: 3, evidence: [0.5; 28], ..Zeroable::zeroed() };
        let mut bytes = AlignedBytes::zeroed(GateDecisions::byte_len(2));
        GateDecisions::write(&mut bytes, &[one, one]);
        assert_eq!(GateDecisions::view(&bytes).unwrap().decisions, &[one, one]);
        assert!(GateDecisions::view(&AlignedBytes::copy_of(&bytes[..128])).is_err());
    }
}
