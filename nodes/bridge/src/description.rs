//! The objects as a robot description (URDF) that rviz's RobotModel shows: one link a frame, the mesh as its visual.

use pseudoflow_edge::Catalogue;
use std::fmt::Write;

/// The frames of all `instances` below the optical frame `root`, which joints of type `floating` leave to `/tf`.
pub(crate) fn urdf(
    catalogue: &Catalogue,
    prefix: &str,
    root: &str,
    instances: impl Iterator<Item = (u32, u32)>,
) -> String {
    let root = escaped(root);
    let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"pseudoflow\">\n  <link name=\"{root}\"/>\n");
    for (object_id, instance) in instances {
        let frame = escaped(&format!("{prefix}{}", catalogue.naming.token(object_id, instance)));
        let visual = catalogue.meshes.get(&object_id).map_or(String::new(), |mesh| {
            let (file, scale) = (escaped(&mesh.path.display().to_string()), mesh.metres_per_unit);
            format!(
                "<visual><geometry><mesh filename=\"file://{file}\" scale=\"{scale} {scale} {scale}\"/></geometry></visual>"
            )
        });
        // Writing into a String cannot fail.
        let _ = writeln!(text, "  <link name=\"{frame}\">{visual}</link>");
        let _ = writeln!(
            text,
            "  <joint name=\"{root}_to_{frame}\" type=\"floating\"><parent link=\"{root}\"/><child link=\"{frame}\"/></joint>"
        );
    }
    text + "</robot>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use pseudoflow_edge::MeshFile;
    use pseudoflow_msgs::ros::Naming;

    #[test]
    fn each_frame_is_a_link_with_its_mesh() {
        let catalogue = Catalogue {
            naming: Naming::new([(5, "soup can".to_owned())].into()).unwrap(),
            folder: "/sets".into(),
            meshes: [(5, MeshFile { path: "/sets/a&b/obj_000005.ply".into(), metres_per_unit: 1e-3 })].into(),
        };
        let text = urdf(&catalogue, "left/", "optical", [(5, 0), (5, 1)].into_iter());
        for expected in [
            "<link name=\"optical\"/>",
            "<link name=\"left/soup_can\">",
            "<child link=\"left/soup_can_1\"/>",
            "file:///sets/a&amp;b/obj_000005.ply\" scale=\"0.001 0.001 0.001\"",
        ] {
            assert!(text.contains(expected), "{text}");
        }
    }
}
