//! A mask of the own craft as a picture file.

use super::PipelineError;
use crate::image::Image;
use crate::shell::support::bounded_file;
use crate::shell::support::file_error::FileError;
use std::format;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Most bytes of a mask's file.
const MOST_BYTES: u64 = 32 << 20;

/// Largest difference of the aspect ratios of mask and frame, as a share.
const ASPECT: f64 = 0.02;

/// A grey picture with the aspect ratio of the frames; black pixels are not looked at.
#[derive(Debug, Clone)]
pub struct MaskFile {
    path: PathBuf,
    pixels: Vec<u8>,
    size: (usize, usize),
}

impl MaskFile {
    /// Reads a picture (PNG, PGM or JPEG); brightness below a half is black.
    ///
    /// # Errors
    /// [`PipelineError::File`], [`PipelineError::Mask`].
    pub fn load(path: &Path) -> Result<Self, PipelineError> {
        let bytes = bounded_file::read(path, MOST_BYTES).map_err(FileError::read(path))?;
        let refused = |reason: String| PipelineError::Mask { path: path.into(), reason };
        let grey = image::load_from_memory(&bytes).map_err(|e| refused(e.to_string()))?.to_luma8();
        let size = (grey.width() as usize, grey.height() as usize);
        let pixels: Vec<u8> = grey.into_raw().into_iter().map(|p| 255 * (p >> 7)).collect();
        if pixels.iter().all(|&pixel| pixel == 0) {
            return Err(refused("all of it is black, so nothing would be looked at".into()));
        }
        Ok(Self { path: path.into(), pixels, size })
    }

    /// The picture, for frames of this size.
    ///
    /// # Errors
    /// [`PipelineError::Mask`] for frames of another aspect ratio.
    pub fn for_frames(&self, width: usize, height: usize) -> Result<Image<'_>, PipelineError> {
        let refused = |reason: String| PipelineError::Mask { path: self.path.clone(), reason };
        let aspect = |(width, height): (usize, usize)| width as f64 / height.max(1) as f64;
        let ratio = aspect(self.size) / aspect((width, height)).max(1e-9);
        if (ratio - 1.0).abs() > ASPECT {
            return Err(refused(format!(
                "it is {}x{}, the frames are {width}x{height}: another aspect ratio",
                self.size.0, self.size.1
            )));
        }
        Image::packed(&self.pixels, self.size.0, self.size.1).map_err(|e| refused(e.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn what_cannot_be_a_mask_is_named() {
        let folder = std::env::temp_dir().join(format!("lookout-mask-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let write = |name: &str, bytes: &[u8]| {
            let path = folder.join(name);
            fs::write(&path, bytes).unwrap();
            path
        };
        let pgm = |pixels: [u8; 8]| [&b"P5\n4 2\n255\n"[..], &pixels].concat();
        let error = |path: &Path| MaskFile::load(path).unwrap_err().to_string();
        assert!(error(&folder.join("none.png")).contains("none.png"));
        assert!(error(&write("text.png", b"no picture")).contains("text.png"));
        assert!(error(&write("black.pgm", &pgm([9; 8]))).contains("all of it is black"));
        let mask =
            MaskFile::load(&write("good.pgm", &pgm([0, 127, 128, 255, 0, 0, 255, 255]))).unwrap();
        let view = mask.for_frames(640, 320).unwrap();
        assert_eq!((view.row(0), view.row(1)), (&[0, 0, 255, 255][..], &[0, 0, 255, 255][..]));
        let error = mask.for_frames(640, 480).unwrap_err().to_string();
        assert!(error.contains("good.pgm") && error.contains("640x480"), "{error}");
        fs::remove_dir_all(&folder).unwrap();
    }
}
