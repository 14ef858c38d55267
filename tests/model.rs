//! No bytes make a model that panics; each refusal says why.

mod common;

use common::{assemble, forest, model, repair, sections};
use lookout::detector::{Buffers, Config, Detector};
use lookout::model::{HEADER, Model, ModelError, Section, VERSION};
use lookout::stcube::feature::Features;
use lookout::trees::{ForestError, NEVER_REJECT};
use proptest::prelude::*;

/// One change to a file; places are taken modulo its length.
#[derive(Debug, Clone)]
enum Change {
    Flip(usize, u8),
    Word(usize, i32),
    Insert(usize, u8),
    Remove(usize),
    Cut(usize),
}

fn change() -> impl Strategy<Value = Change> {
    let place = 0..1usize << 20;
    // Lengths and the headers of forests are where a change matters most.
    let near = prop_oneof![0..HEADER + 60, place.clone()];
    prop_oneof![
        4 => (near.clone(), any::<u8>()).prop_map(|(at, with)| Change::Flip(at, with)),
        2 => (place.clone(), prop_oneof![Just(i32::MAX), Just(i32::MIN), any::<i32>()])
            .prop_map(|(at, with)| Change::Word(at, with)),
        1 => (near, any::<u8>()).prop_map(|(at, with)| Change::Insert(at, with)),
        1 => place.clone().prop_map(Change::Remove),
        1 => place.prop_map(Change::Cut),
    ]
}

fn apply(bytes: &mut Vec<u8>, change: &Change) {
    let end = bytes.len().max(1);
    match *change {
        Change::Flip(at, with) => {
            bytes.iter_mut().skip(at % end).take(1).for_each(|byte| *byte ^= with);
        }
        Change::Word(at, with) => {
            let with = with.to_le_bytes();
            bytes.iter_mut().skip(at % end / 4 * 4).zip(with).for_each(|(b, w)| *b = w);
        }
        Change::Insert(at, with) => bytes.insert(at % (bytes.len() + 1), with),
        Change::Remove(at) if !bytes.is_empty() => {
            bytes.remove(at % end);
        }
        Change::Remove(_) => {}
        Change::Cut(at) => bytes.truncate(at % end),
    }
}

/// Three frames of a moving scene through a detector of `model`.
fn run(model: &Model<'_>) {
    let config = Config { max_target: 20, ..Config::for_model(model, 64, 48) };
    let (mut bytes, mut words) = common::memory(&config, 0);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(model, config, buffers).unwrap();
    common::look(&mut detector, config, 0, 3);
}

proptest! {
    #[test]
    fn changed_files_are_refused(changes in prop::collection::vec(change(), 1..4)) {
        let good = model();
        let mut bytes = good.clone();
        changes.iter().for_each(|change| apply(&mut bytes, change));
        // Only the two reserved bytes are neither checked nor covered.
        let same = bytes.len() == good.len() && bytes[..10] == good[..10] && bytes[12..] == good[12..];
        prop_assert_eq!(Model::parse(&bytes).is_ok(), same);
    }

    #[test]
    fn what_is_accepted_runs(changes in prop::collection::vec(change(), 1..4)) {
        let mut bytes = model();
        changes.iter().for_each(|change| apply(&mut bytes, change));
        repair(&mut bytes);
        if let Ok(model) = Model::parse(&bytes) {
            run(&model);
        }
    }

    #[test]
    fn any_content_of_a_section_is_refused_or_runs(
        section in 0..Section::ALL.len(),
        changes in prop::collection::vec(change(), 1..4),
    ) {
        let mut sections = sections();
        changes.iter().for_each(|change| apply(&mut sections[section], change));
        let bytes = assemble(&sections);
        if let Ok(model) = Model::parse(&bytes) {
            prop_assert_eq!(model.section(Section::ALL[section]), &sections[section]);
            run(&model);
        }
    }

    #[test]
    fn forests_of_the_largest_numbers_run(
        section in prop::sample::select(vec![
            Section::Scan, Section::Horizontal, Section::Vertical, Section::Cube,
            Section::BoxX, Section::BoxY, Section::BoxWidth, Section::BoxHeight,
            Section::FitX, Section::FitY, Section::FitWidth, Section::FitHeight,
        ]),
        other in prop::sample::select(vec![
            Section::Horizontal, Section::Vertical, Section::BoxX, Section::BoxY, Section::BoxWidth,
            Section::FitX, Section::FitHeight,
        ]),
        bias in prop_oneof![Just(i32::MAX - 0x8000), Just(i32::MIN + 0x8000), any::<i16>().prop_map(|b| i32::from(b) << 15)],
    ) {
        let mut sections = sections();
        let keen = |bias| forest(1, bias, &[(NEVER_REJECT, vec![(0, 9)], vec![-9, 9])]);
        for section in [Section::Scan, Section::Cube] {
            sections[section as usize] = keen(0);
        }
        sections[other as usize] = keen(-bias);
        sections[section as usize] = keen(bias);
        let bytes = assemble(&sections);
        run(&Model::parse(&bytes).unwrap());
    }
}

#[test]
fn every_truncation_is_refused() {
    let bytes = model();
    for end in 0..bytes.len() {
        let error = Model::parse(&bytes[..end]).unwrap_err();
        let expected = match end {
            0..10 => ModelError::NotAModel,
            10..HEADER => ModelError::Length { expected: HEADER, found: end },
            _ => ModelError::Length { expected: bytes.len(), found: end },
        };
        assert_eq!(error, expected);
        let mut repaired = bytes[..end].to_vec();
        repair(&mut repaired);
        assert!(Model::parse(&repaired).is_err(), "cut off at {end}");
    }
}

/// The refusal of the model after `change` and repair, and its text.
fn refusal(change: impl FnOnce(&mut Vec<u8>)) -> (ModelError, String) {
    let mut bytes = model();
    change(&mut bytes);
    let error = Model::parse(&bytes).unwrap_err();
    (error, error.to_string())
}

/// The refusal of the model with another content of `section`, and its text.
fn refused(section: Section, content: &[u8]) -> (ModelError, String) {
    let mut sections = sections();
    sections[section as usize] = content.to_vec();
    refusal(|bytes| *bytes = assemble(&sections))
}

#[test]
fn each_refusal_says_why() {
    let (error, text) = refusal(|bytes| bytes[0] = b'l');
    assert_eq!(error, ModelError::NotAModel);
    assert!(text.contains("not a Lookout model"));

    let (error, text) = refusal(|bytes| bytes[8] += 1);
    assert_eq!(error, ModelError::Version { found: VERSION + 1 });
    assert!(text.contains("model format 4") && text.contains("reads formats 1 to 3"), "{text}");

    let (error, text) = refusal(|bytes| bytes.push(0));
    let length = model().len();
    assert_eq!(error, ModelError::Length { expected: length, found: length + 1 });
    assert!(text.contains(&format!("{} bytes instead of {length}", length + 1)), "{text}");

    // Sections that are longer, and shorter, together than the file says.
    let (error, _) = refusal(|bytes| {
        bytes[HEADER - 4] += 1;
        repair(bytes);
    });
    assert_eq!(error, ModelError::Length { expected: length + 1, found: length });
    let (error, _) = refusal(|bytes| {
        bytes.push(0);
        repair(bytes);
    });
    assert_eq!(error, ModelError::Length { expected: length, found: length + 1 });

    let (error, text) = refusal(|bytes| bytes[HEADER] ^= 1);
    assert_eq!(error, ModelError::Checksum);
    assert!(text.contains("checksum"));

    // Window, channels of the map; parts, scales and a history that do not exist.
    for (place, value) in [(20, 11), (24, 15), (25, 12), (25, 64), (26, 0), (26, 5), (27, 2)] {
        let (error, text) = refusal(|bytes| {
            bytes[place] = value;
            repair(bytes);
        });
        assert_eq!(error, ModelError::Geometry);
        assert!(text.contains("windows or channels"));
    }

    let beyond = forest(4, 0, &[(NEVER_REJECT, vec![(4, 0)], vec![0, 0])]);
    let (error, text) = refused(Section::Vertical, &beyond);
    let feature = ForestError::Feature { tree: 0, node: 0, feature: 4, features: 4 };
    assert_eq!(error, ModelError::Trees { section: Section::Vertical, error: feature });
    assert!(text.contains("vertical regressor") && text.contains("feature 4 of 4"), "{text}");

    let (error, text) = refused(Section::Calibration, &[0xff; 8]);
    assert_eq!(error, ModelError::Content { section: Section::Calibration });
    assert!(text.contains("precisions are not valid"), "{text}");

    let (error, text) = refused(Section::Provenance, &[0xff]);
    assert_eq!(error, ModelError::Content { section: Section::Provenance });
    assert!(text.contains("provenance"));
}

#[test]
fn features_out_of_range_are_refused() {
    let content = |section: Section, content: &[u8]| {
        assert_eq!(refused(section, content).0, ModelError::Content { section });
    };
    // Forests that may ask for more features than there are.
    let forests = [
        (Section::Scan, 1600),
        (Section::Horizontal, 4),
        (Section::Vertical, 4),
        (Section::Cube, 40),
        (Section::BoxX, 40),
        (Section::BoxY, 40),
        (Section::BoxWidth, 40),
        (Section::BoxHeight, 40),
        (Section::FitX, 30),
        (Section::FitY, 30),
        (Section::FitWidth, 30),
        (Section::FitHeight, 30),
    ];
    for (section, features) in forests {
        content(section, &forest(features + 1, 0, &[]));
        content(section, &[forest(features, 0, &[]), vec![0; 4]].concat());
    }
    // Boxes that leave the cube, are empty, ask for channels that are not there, or are cut off.
    let good = [1, 6, 0, 10, 0, 10, 0, 1];
    assert!(Features::parse(&good).is_some());
    for (place, value) in [(0, 5), (1, 16), (2, 10), (3, 11), (3, 0), (5, 11), (7, 5), (7, 0)] {
        let mut bad = good;
        bad[place] = value;
        content(Section::CubeFeatures, &bad);
        content(Section::PatchFeatures, &bad);
        content(Section::FitFeatures, &bad);
    }
    // Of older slices, which a stretched window does not have.
    content(Section::FitFeatures, &[1, 6, 0, 10, 0, 10, 0, 2]);
    content(Section::FitFeatures, &[1, 6, 0, 10, 0, 10, 1, 2]);
    content(Section::CubeFeatures, &[1, 8, 0, 10, 0, 10, 0, 2]);
    content(Section::CubeFeatures, &good[..7]);
    // Features of a cube, not of a single patch.
    for bad in [[1, 6, 0, 10, 0, 10, 0, 2], [1, 8, 0, 10, 0, 10, 0, 1], [4, 6, 0, 1, 0, 1, 0, 1]] {
        content(Section::PatchFeatures, &bad);
    }
}

#[test]
fn a_model_is_what_was_written() {
    let (sections, bytes) = (sections(), model());
    let model = Model::parse(&bytes).unwrap();
    assert_eq!(model.bytes(), bytes);
    assert_eq!(model.method(), common::METHOD);
    assert_eq!(model.provenance(), r#"{"made":"by hand"}"#);
    // 0.9 as 58 982 / 65 536: a score of 0.
    assert_eq!(
        [1, 58_982, 58_983, 65_537].map(|p| model.calibration().threshold(p)),
        [Some(-1 << 16), Some(0), Some(3 << 16), None]
    );
    for section in Section::ALL {
        assert_eq!(model.section(section), sections[section as usize]);
    }
    run(&model);
}

#[test]
fn older_versions_are_read_without_what_they_do_not_know() {
    let sections = sections();
    for (version, first_missing) in [(1, Section::Calibration), (2, Section::FitFeatures)] {
        let known = first_missing as usize;
        let mut bytes = model();
        let missing = &sections[known..];
        bytes.truncate(bytes.len() - missing.iter().map(Vec::len).sum::<usize>());
        bytes.drain(HEADER - 4 * missing.len()..HEADER);
        bytes[8] = version;
        repair(&mut bytes);
        let model = Model::parse(&bytes).unwrap();
        for (i, section) in Section::ALL.into_iter().enumerate() {
            assert_eq!(model.section(section), if i < known { &sections[i][..] } else { &[] });
        }
        assert_eq!(model.calibration().threshold(0).is_some(), version == 2);
        assert!(model.fit().is_none());
        run(&model);
    }
}

#[test]
fn a_model_may_do_without_fits_but_not_without_a_part_of_them() {
    let mut without = sections();
    Section::FIT.iter().for_each(|&section| without[section as usize].clear());
    let bytes = assemble(&without);
    let model = Model::parse(&bytes).unwrap();
    assert!(model.fit().is_none());
    run(&model);
    for section in Section::FIT {
        let mut sections = sections();
        sections[section as usize].clear();
        assert!(Model::parse(&assemble(&sections)).is_err(), "{section:?}");
    }
}
