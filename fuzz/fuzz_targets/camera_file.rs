//! Camera files: YAML of OpenCV and ROS, JSON of Lookout. The first byte selects the form.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lookout::shell::formats::camera_file;

fuzz_target!(|data: &[u8]| {
    let Some((&form, text)) = data.split_first() else { return };
    let name = if form & 1 == 0 { "camera.yaml" } else { "camera.json" };
    let _ = camera_file::read(&lookout_fuzz::file(name, text));
});
