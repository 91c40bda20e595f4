//! Pictures out of recordings, for backgrounds.

use anyhow::{Context as _, Result, ensure};
use pseudoflow_imaging::{RgbImage, encode_jpeg};
use pseudoflow_player::{BagOptions, BagSource, FrameSource as _};
use std::path::{Path, PathBuf};

/// Most frames that are taken from a recording, evenly over its length.
const MOST_FRAMES: usize = 200;
const JPEG_QUALITY: u8 = 92;

/// The folders as they are; for each bag a folder beside `out` with its frames.
pub(super) fn picture_folders(sources: &[PathBuf], out: &Path) -> Result<Vec<PathBuf>> {
    let folder = |(number, source): (usize, &PathBuf)| match is_bag(source) {
        true => frames_of(source, &out.with_extension(format!("backgrounds/{number:02}"))),
        false => Ok(source.clone()),
    };
    sources.iter().enumerate().map(folder).collect()
}

fn is_bag(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "mcap") || path.join("metadata.yaml").is_file()
}

/// Writes frames of a bag to a folder; what an earlier run wrote there is kept, so that a training resumes with the same.
fn frames_of(bag: &Path, folder: &Path) -> Result<PathBuf> {
    let complete = folder.join("complete");
    let origin = bag.display().to_string();
    if std::fs::read_to_string(&complete).is_ok_and(|text| text == origin) {
        return Ok(folder.to_owned());
    }
    let mut source = BagSource::open(bag, &BagOptions::default()).with_context(|| format!("--backgrounds {origin}"))?;
    let count = source.count();
    ensure!(count > 0, "--backgrounds {origin}: the bag holds no image; record one, or give a folder of pictures");
    if folder.is_dir() {
        std::fs::remove_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    for number in (0..count).step_by(count.div_ceil(MOST_FRAMES)) {
        let frame = source.load(number)?;
        let (width, height) = (frame.header.width, frame.header.height);
        let image = RgbImage::from_raw(width, height, frame.rgb).context("a frame that is not as large as it says")?;
        let path = folder.join(format!("{number:06}.jpg"));
        std::fs::write(&path, encode_jpeg(&image, JPEG_QUALITY)?).with_context(|| path.display().to_string())?;
    }
    std::fs::write(&complete, &origin).with_context(|| complete.display().to_string())?;
    log::info!("{origin}: frames for backgrounds in {}", folder.display());
    Ok(folder.to_owned())
}
