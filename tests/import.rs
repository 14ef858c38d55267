//! `lookout import` on small data sets of each form, made here.
#![cfg(feature = "std")]

use lookout::shell::formats::class::Class;
use lookout::shell::formats::clips::{self, Clip};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

fn lookout(folder: &TempDir, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lookout"))
        .args(args)
        .current_dir(folder.path())
        .env_remove("LOOKOUT_LOG")
        .output()
        .unwrap()
}

fn write(folder: &TempDir, name: &str, text: &str) {
    let path = folder.path().join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

/// Pictures of 64 x 48.
fn pictures(folder: &TempDir, names: &[&str]) {
    for name in names {
        write(folder, name, "");
        image::GrayImage::new(64, 48).save(folder.path().join(name)).unwrap();
    }
}

/// Imports `src` of the folder and reads the clips.
fn imported(folder: &TempDir, form: &str, more: &[&str]) -> Vec<Clip> {
    let args = [&["import", form, "src", "--out", "out"], more].concat();
    let output = lookout(folder, &args);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    clips::clips(&folder.path().join("out")).unwrap()
}

fn complaint(folder: &TempDir, form: &str) -> String {
    let output = lookout(folder, &["import", form, "src", "--out", "out"]);
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stdout));
    assert!(!folder.path().join("out").exists(), "nothing is written");
    String::from_utf8(output.stderr).unwrap()
}

/// Frame, number, left, top, width, height, class, visibility of every box.
fn boxes(clip: &Clip) -> Vec<(u64, i64, [f64; 4], Class, f64)> {
    let row = |(frame, b): (u64, &clips::TruthBox)| {
        (frame, b.id, [b.left, b.top, b.width, b.height], b.class, b.visibility)
    };
    clip.ground_truth.boxes().map(row).collect()
}

fn frames(clip: &Clip) -> u64 {
    clip.frame_count().unwrap()
}

#[test]
fn yolo() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["a_1.png", "a_2.png", "b_1.png", "b_2.png"];
    let names = names.map(|name| format!("src/images/train/{name}"));
    pictures(&folder, &names.each_ref().map(String::as_str));
    write(&folder, "src/data.yaml", "path: .\ntrain: images/train\nnames:\n  0: uav\n  1: Bird\n");
    // Middle and size in shares of 64 x 48.
    write(
        &folder,
        "src/labels/train/a_1.txt",
        "0 0.5 0.5 0.25 0.25\r\n1 0.125 0.25 0.0625 0.125\r\n",
    );
    write(&folder, "src/labels/train/b_2.txt", "0 0.75 0.5 0.5 0.5 7\n");
    let clips = imported(&folder, "yolo", &["--fps", "10"]);
    let names: Vec<&str> = clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["a", "b"]);
    assert_eq!(
        boxes(&clips[0]),
        [
            (1, 1, [24.0, 18.0, 16.0, 12.0], Class::Drone, 1.0),
            (1, 2, [6.0, 9.0, 4.0, 6.0], Class::Bird, 1.0)
        ]
    );
    assert_eq!(boxes(&clips[1]), [(2, 7, [32.0, 12.0, 32.0, 24.0], Class::Drone, 1.0)]);
    assert_eq!((frames(&clips[0]), clips[0].info.frame_rate), (2, Some(10.0)));
    assert_eq!(clips[0].info.size, Some((64, 48)));
    let link = folder.path().join("out/a/frames/000001.png");
    assert!(link.is_symlink() && image::open(&link).is_ok());
    // A second time into the same folder.
    let again = lookout(&folder, &["import", "yolo", "src", "--out", "out"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("out/a: is there already"));
}

#[test]
fn classes_are_mapped_or_listed() {
    let folder = tempfile::tempdir().unwrap();
    pictures(&folder, &["src/1.png", "src/2.png"]);
    write(&folder, "src/1.txt", "0 0.5 0.5 0.25 0.25\n3 0.5 0.5 0.25 0.25\n");
    write(&folder, "src/2.txt", "3 0.5 0.5 0.25 0.25\n5 0.5 0.5 0.25 0.25\n");
    let text = complaint(&folder, "yolo");
    assert!(
        text.contains("classes not known: '0' (1 boxes), '3' (2 boxes), '5' (1 boxes); map them"),
        "{text}"
    );
    write(&folder, "map.txt", "0 = helicopter\n3 = ignore\n5 = skip\n");
    let clips = imported(&folder, "yolo", &["--classes", "map.txt", "--copy"]);
    let rect = [24.0, 18.0, 16.0, 12.0];
    assert_eq!(
        boxes(&clips[0]),
        [
            (1, 1, rect, Class::Helicopter, 1.0),
            (1, 2, rect, Class::Drone, 0.0),
            (2, 3, rect, Class::Drone, 0.0)
        ]
    );
    assert!(!folder.path().join("out/src/frames/000001.png").is_symlink(), "--copy");
}

#[test]
fn coco_and_its_videos() {
    let folder = tempfile::tempdir().unwrap();
    pictures(&folder, &["src/images/x-1.png", "src/images/x-2.png", "src/images/v/000.png"]);
    let json = r#"{"info": {}, "licenses": [],
        "videos": [{"id": 4, "name": "flight four"}],
        "categories": [{"id": 3, "name": "drone"}, {"id": 9, "name": "bird"}],
        "images": [
            {"id": 11, "file_name": "x-2.png", "width": 64, "height": 48},
            {"id": 10, "file_name": "x-1.png", "width": 64, "height": 48},
            {"id": 12, "file_name": "v/000.png", "width": 64, "height": 48, "video_id": 4, "frame_id": 0}],
        "annotations": [
            {"id": 1, "image_id": 11, "category_id": 3, "bbox": [1.5, 2, 10, 9], "area": 90, "iscrowd": 0},
            {"id": 2, "image_id": 10, "category_id": 9, "bbox": [3, 4, 5, 6], "iscrowd": 1},
            {"id": 3, "image_id": 12, "category_id": 3, "bbox": [3, 4, 5, 6], "track_id": 77}]}"#;
    write(&folder, "src/annotations/instances.json", json);
    write(&folder, "src/annotations/other.json", r#"{"something": "else"}"#);
    let clips = imported(&folder, "coco", &[]);
    let names: Vec<&str> = clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["flight four", "x"]);
    assert_eq!(boxes(&clips[0]), [(1, 77, [3.0, 4.0, 5.0, 6.0], Class::Drone, 1.0)]);
    assert_eq!(
        boxes(&clips[1]),
        [
            (1, 1, [3.0, 4.0, 5.0, 6.0], Class::Bird, 0.0),
            (2, 2, [1.5, 2.0, 10.0, 9.0], Class::Drone, 1.0)
        ]
    );
    write(
        &folder,
        "src/annotations/instances.json",
        &json.replace("\"category_id\": 9", "\"category_id\": 8"),
    );
    fs::remove_dir_all(folder.path().join("out")).unwrap();
    assert!(
        complaint(&folder, "coco")
            .contains("category_id is '8', expected a number that categories holds")
    );
    write(&folder, "src/annotations/instances.json", "{\"images\": [");
    assert!(complaint(&folder, "coco").contains("instances.json: EOF"));
}

#[test]
fn motchallenge() {
    let folder = tempfile::tempdir().unwrap();
    pictures(&folder, &["src/train/S-1/img1/000001.png", "src/train/S-1/img1/000002.png"]);
    write(
        &folder,
        "src/train/S-1/seqinfo.ini",
        "[Sequence]\nimDir=img1\nframeRate=15\nseqLength=2\nimWidth=64\nimHeight=48\n",
    );
    write(
        &folder,
        "src/train/S-1/gt/gt.txt",
        "1,3,10,11,12,13,1,1,0.9\n2,3,10,11,12,13,0,7,1\n2,4,1,2,3,4,1,7,1\n",
    );
    assert!(complaint(&folder, "mot").contains("class not known: '7' (2 boxes)"));
    write(&folder, "map", "7 = bird");
    let clips = imported(&folder, "mot", &["--classes", "map"]);
    assert_eq!(
        boxes(&clips[0]),
        [
            (1, 3, [10.0, 11.0, 12.0, 13.0], Class::Drone, 0.9),
            (2, 3, [10.0, 11.0, 12.0, 13.0], Class::Bird, 0.0),
            (2, 4, [1.0, 2.0, 3.0, 4.0], Class::Bird, 1.0)
        ]
    );
    assert_eq!(clips[0].info.frame_rate, Some(15.0));
}

#[test]
fn cvat_video_and_images() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder, "src/flight.mp4", "");
    let xml = r#"<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version>
 <meta><task><name>flight</name><size>3</size><original_size><width>64</width><height>48</height></original_size></task><source>flight.mp4</source></meta>
 <track id="0" label="drone" source="manual">
  <box frame="0" outside="0" occluded="0" keyframe="1" xtl="1.00" ytl="2.50" xbr="11.00" ybr="12.50" z_order="0"></box>
  <box frame="1" outside="0" occluded="1" keyframe="0" xtl="2.00" ytl="2.50" xbr="12.00" ybr="12.50" z_order="0"></box>
  <box frame="2" outside="1" occluded="0" keyframe="1" xtl="2.00" ytl="2.50" xbr="12.00" ybr="12.50" z_order="0"></box>
 </track></annotations>"#;
    write(&folder, "src/annotations.xml", xml);
    let clips = imported(&folder, "cvat", &[]);
    assert_eq!(
        boxes(&clips[0]),
        [
            (1, 1, [1.0, 2.5, 10.0, 10.0], Class::Drone, 1.0),
            (2, 1, [2.0, 2.5, 10.0, 10.0], Class::Drone, 0.5)
        ]
    );
    assert!(clips[0].input.ends_with("video.mp4") && clips[0].input.is_symlink());
    write(&folder, "src/annotations.xml", &xml.replace("track id=\"0\"", "track id=\"1e30\""));
    fs::remove_dir_all(folder.path().join("out")).unwrap();
    let text = complaint(&folder, "cvat");
    assert!(text.contains("annotations.xml:4: id is '1e30', expected a number from 0"), "{text}");

    let folder = tempfile::tempdir().unwrap();
    pictures(&folder, &["src/images/f_1.png", "src/images/f_2.png"]);
    let xml = r#"<annotations><version>1.1</version>
 <image id="0" name="f_1.png" width="64" height="48"></image>
 <image id="1" name="f_2.png" width="64" height="48"><box label="bird" occluded="0" xtl="1" ytl="2" xbr="4" ybr="6"/></image>
</annotations>"#;
    write(&folder, "src/annotations.xml", xml);
    let clips = imported(&folder, "cvat", &[]);
    assert_eq!(boxes(&clips[0]), [(2, 1, [1.0, 2.0, 3.0, 4.0], Class::Bird, 1.0)]);
    assert_eq!(frames(&clips[0]), 2);
    write(&folder, "src/annotations.xml", &xml.replace("xtl=\"1\"", "xtl=\"left\""));
    fs::remove_dir_all(folder.path().join("out")).unwrap();
    let text = complaint(&folder, "cvat");
    assert!(text.contains("annotations.xml:3: xtl is 'left', expected a number"), "{text}");
}

#[test]
fn pascal_voc() {
    let folder = tempfile::tempdir().unwrap();
    pictures(&folder, &["src/JPEGImages/f_1.png", "src/JPEGImages/f_2.png"]);
    let xml = |objects: &str| {
        format!(
            "<annotation><filename>f.png</filename><size><width>64</width><height>48</height><depth>1</depth></size>{objects}</annotation>"
        )
    };
    let object = |name: &str, difficult: u8| {
        format!(
            "<object><name>{name}</name><difficult>{difficult}</difficult><bndbox><xmin>5</xmin><ymin>6</ymin><xmax>15</xmax><ymax>26</ymax></bndbox></object>"
        )
    };
    write(&folder, "src/Annotations/f_1.xml", &xml(&(object("Drone", 0) + &object("drone", 1))));
    write(&folder, "src/Annotations/f_2.xml", &xml(""));
    let clips = imported(&folder, "voc", &[]);
    let rect = [5.0, 6.0, 10.0, 20.0];
    assert_eq!(
        boxes(&clips[0]),
        [(1, 1, rect, Class::Drone, 1.0), (1, 2, rect, Class::Drone, 0.0)]
    );
    assert_eq!((clips[0].name.as_str(), frames(&clips[0])), ("f", 2));
    write(&folder, "src/Annotations/f_2.xml", "<annotation><object>");
    fs::remove_dir_all(folder.path().join("out")).unwrap();
    assert!(complaint(&folder, "voc").contains("f_2.xml: "));
}

#[test]
fn airborne_object_tracking() {
    let folder = tempfile::tempdir().unwrap();
    pictures(&folder, &["src/Images/f00d/100.png", "src/Images/f00d/200.png"]);
    let json = r#"{"metadata": {"description": "x"}, "samples": {"f00d": {
        "metadata": {"data_path": "train/f00d", "fps": 10.0, "number_of_frames": 3, "resolution": {"height": 48, "width": 64}},
        "entities": [
            {"time": 200, "blob": {"frame": 1, "range_distance_m": 300.0}, "id": "Airplane1", "bb": [10.0, 11.0, 12.0, 5.0], "img_name": "200.png", "labels": {"is_above_horizon": 1}},
            {"time": 100, "blob": {"frame": 0}, "img_name": "100.png"},
            {"time": 200, "blob": {"frame": 1}, "id": "Bird3", "bb": [1.0, 2.0, 3.0, 4.0], "img_name": "200.png"},
            {"time": 300, "blob": {"frame": 2}, "id": "Airplane1", "bb": [1.0, 2.0, 3.0, 4.0], "img_name": "300.png"}]}}}"#;
    write(&folder, "src/ImageSets/groundtruth.json", json);
    let clips = imported(&folder, "aot", &[]);
    // The third picture is not on this disk.
    assert_eq!(
        boxes(&clips[0]),
        [
            (2, 1, [10.0, 11.0, 12.0, 5.0], Class::Airplane, 1.0),
            (2, 2, [1.0, 2.0, 3.0, 4.0], Class::Bird, 1.0)
        ]
    );
    assert_eq!((frames(&clips[0]), clips[0].info.frame_rate), (2, Some(10.0)));
}

#[test]
fn what_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("src")).unwrap();
    for form in ["yolo", "coco", "mot", "cvat", "voc", "aot"] {
        assert!(complaint(&folder, form).contains("src: no labels of this form in it"), "{form}");
    }
    let gone = lookout(&folder, &["import", "yolo", "nowhere", "--out", "out"]);
    assert!(String::from_utf8_lossy(&gone.stderr).contains("nowhere: cannot be read"));
    assert!(!Path::new("out").exists());
}
