//! Labels of other forms, in a folder with one picture. The first byte selects the form.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::import::{self, LabelFormat};
use std::fs;

/// A grey picture of 32 x 32 pixels, which YOLO's shares refer to.
fn picture() -> Vec<u8> {
    [&b"P5 32 32 255\n"[..], &[128; 1024]].concat()
}

fuzz_target!(|data: &[u8]| {
    let Some((&form, text)) = data.split_first() else { return };
    let (form, name) = match form % 6 {
        0 => (LabelFormat::Yolo, "picture_0001.txt"),
        1 => (LabelFormat::Coco, "labels.json"),
        2 => (LabelFormat::Mot, "gt.txt"),
        3 => (LabelFormat::Cvat, "labels.xml"),
        4 => (LabelFormat::Voc, "picture_0001.xml"),
        _ => (LabelFormat::Aot, "groundtruth.json"),
    };
    let folder = lookout_fuzz::folder("import");
    fs::write(folder.join("picture_0001.pgm"), picture()).expect("a file can be written");
    let path = folder.join(name);
    fs::write(&path, text).expect("a file can be written");
    let sequences = import::read(form, &folder);
    fs::remove_file(path).expect("the file is there");
    for label in sequences.unwrap_or_default().iter().flat_map(|sequence| &sequence.labels) {
        assert!(label.rect.iter().all(|value| value.is_finite()), "{label:?}");
        assert!((0.0..=1.0).contains(&label.visibility), "{label:?}");
    }
});
