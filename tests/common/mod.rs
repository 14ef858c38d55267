//! A small model put together by hand from the documented layout, and runs of the detector.
#![allow(dead_code, reason = "every test binary uses a part of these")]

pub mod golden;

use lookout::detector::{Buffers, Config, Detections, Detector, History};
use lookout::image::Image;
use lookout::model::calibration::Knot;
use lookout::model::{self, GEOMETRY, MAGIC, Method, Model, Section, VERSION};
use lookout::scan::cascade;
use lookout::stcube::compensation::Alignment;
use lookout::trees::NEVER_REJECT;

/// Sections of a model under way.
pub type Sections = [Vec<u8>; Section::ALL.len()];

/// One tree: reject threshold, nodes in heap order, leaves from left to right.
pub type Tree = (i32, Vec<(u16, u16)>, Vec<i16>);

/// Provenance of the models here.
pub const METHOD: Method = Method {
    registration: true,
    temporal: true,
    alignment: Alignment::Regressors,
    stcube: true,
    persistence: true,
    scales_per_octave: 2,
    history: History::Full,
};

/// Bytes of a forest over `features` features.
pub fn forest(features: u16, bias: i32, trees: &[Tree]) -> Vec<u8> {
    let depth = trees.first().map_or(1, |(_, _, leaves)| leaves.len().ilog2() as u8);
    let mut bytes = (trees.len() as u16).to_le_bytes().to_vec();
    bytes.extend([depth, 0]);
    bytes.extend(bias.to_le_bytes());
    bytes.extend(features.to_le_bytes());
    bytes.extend([0, 0]);
    for (reject, nodes, leaves) in trees {
        bytes.extend(reject.to_le_bytes());
        for (feature, threshold) in nodes {
            bytes.extend(feature.to_le_bytes());
            bytes.extend(threshold.to_le_bytes());
        }
        bytes.extend(leaves.iter().flat_map(|leaf| leaf.to_le_bytes()));
    }
    bytes
}

/// Bytes of a model with these sections.
pub fn assemble(sections: &Sections) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend([0; 10]);
    bytes.extend(GEOMETRY);
    bytes.extend(METHOD.encode());
    sections.iter().for_each(|s| bytes.extend((s.len() as u32).to_le_bytes()));
    sections.iter().for_each(|s| bytes.extend(s));
    repair(&mut bytes);
    bytes
}

/// Makes length and checksum of a changed model right again, if there is room for them.
pub fn repair(bytes: &mut [u8]) {
    if bytes.len() >= 20 {
        let length = bytes.len() as u32;
        bytes[12..16].copy_from_slice(&length.to_le_bytes());
        let checksum = model::checksum(&bytes[20..]);
        bytes[16..20].copy_from_slice(&checksum.to_le_bytes());
    }
}

/// Small numbers that look random and are the same everywhere.
pub struct Numbers(pub u32);

impl Numbers {
    /// The next one, below `end`.
    pub fn below(&mut self, end: u32) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        (self.0 >> 4) % end
    }

    /// Trees over features 0..`features` with thresholds below `thresholds` and leaves within ±`leaf`.
    fn trees(
        &mut self,
        count: usize,
        depth: u32,
        features: u32,
        thresholds: u32,
        leaf: i16,
    ) -> Vec<Tree> {
        let leaves = 1 << depth;
        let mut value = || self.below(2 * leaf as u32 + 1) as i16 - leaf;
        let mut trees: Vec<Tree> = (0..count)
            .map(|_| (NEVER_REJECT, vec![], (0..leaves).map(|_| value()).collect()))
            .collect();
        for (_, nodes, _) in &mut trees {
            nodes.extend(
                (1..leaves).map(|_| (self.below(features) as u16, self.below(thresholds) as u16)),
            );
        }
        trees
    }
}

/// The scan's feature of that cell of the window and that channel of the map.
fn cell(column: u16, row: u16, channel: u16) -> u16 {
    (row * 10 + column) * 16 + channel
}

/// Sections of a model that finds small dark things which move, more or less: every part has trees that matter.
pub fn sections() -> Sections {
    let mut numbers = Numbers(0x2015_0711);
    let mut sections = Sections::default();
    let mut put = |section: Section, bytes: Vec<u8>| sections[section as usize] = bytes;
    put(Section::Provenance, br#"{"made":"by hand"}"#.to_vec());
    // A difference to the last frame, or to the oldest, in the middle; none at the edge; magnitude in between.
    let stump = |reject, feature, threshold| -> Tree {
        (
            reject,
            vec![(feature, threshold), (cell(4, 5, 6), 40), (cell(5, 4, 6), 60)],
            vec![-120, -60, 40, 100],
        )
    };
    let scan = [
        stump(-60, cell(4, 4, 10), 60),
        stump(-20, cell(5, 5, 11), 60),
        stump(0, cell(4, 4, 12), 40),
        (
            20,
            vec![(cell(0, 0, 10), 90), (cell(4, 5, 8), 128), (cell(5, 5, 9), 128)],
            vec![60, 20, 0, -60],
        ),
    ];
    put(Section::Scan, forest(cascade::FEATURES as u16, 10, &scan));
    // Magnitude of the halves of a patch against the whole of it: towards where there is more of it.
    let halves: [[u8; 8]; 4] = [
        [1, 6, 0, 5, 0, 10, 0, 1],
        [1, 6, 5, 10, 0, 10, 0, 1],
        [1, 6, 0, 10, 0, 5, 0, 1],
        [1, 6, 0, 10, 5, 10, 0, 1],
    ];
    put(Section::PatchFeatures, halves.concat());
    let towards = |less: u16, more: u16| -> [Tree; 2] {
        let pull = |feature, by: i16| -> Tree {
            let nodes = vec![(feature, 520), (feature, 400), (feature, 620)];
            (NEVER_REJECT, nodes, vec![0, by / 8, by / 2, by])
        };
        [pull(less, -200), pull(more, 200)]
    };
    put(Section::Horizontal, forest(4, 0, &towards(0, 1)));
    put(Section::Vertical, forest(4, 10, &towards(2, 3)));
    // Boxes of every kind in every slice.
    let mut features = vec![];
    for i in 0..40u8 {
        let mut pair = |end: u32| {
            let first = numbers.below(end) as u8;
            [first, first + 1 + numbers.below(end - u32::from(first)) as u8]
        };
        let (x, y, t) = (pair(10), pair(10), pair(4));
        let channel = i % 16;
        let t = if channel >= 8 && i % 5 < 4 { [0, 1] } else { t };
        features.extend([i % 5, channel, x[0], x[1], y[0], y[1], t[0], t[1]]);
    }
    put(Section::CubeFeatures, features);
    let mut cube = numbers.trees(12, 3, 40, 900, 90);
    cube.iter_mut().skip(3).for_each(|(reject, ..)| *reject = -160);
    put(Section::Cube, forest(40, 60, &cube));
    for section in [Section::BoxX, Section::BoxY, Section::BoxWidth, Section::BoxHeight] {
        put(section, forest(40, -5, &numbers.trees(3, 2, 40, 900, 60)));
    }
    let knots: [(i32, u32); 3] = [(-1 << 16, 1 << 15), (0, 58_982), (3 << 16, 1 << 16)];
    let knot = |(score, precision)| Knot { score, precision }.encode();
    put(Section::Calibration, knots.map(knot).concat());
    // Columns and rows of a stretched window, in channels of every kind.
    let strip = |i: u8| {
        let (x, y) = if i.is_multiple_of(2) {
            ([i % 9, i % 9 + 2], [0, 10])
        } else {
            ([0, 10], [i % 9, i % 9 + 2])
        };
        [i % 4, i % 14, x[0], x[1], y[0], y[1], 0, 1]
    };
    put(Section::FitFeatures, (0..30).flat_map(strip).collect());
    for section in [Section::FitX, Section::FitY, Section::FitWidth, Section::FitHeight] {
        put(section, forest(30, 3, &numbers.trees(4, 3, 30, 900, 40)));
    }
    sections
}

/// `file` as if it had been trained with `method`.
pub fn trained_with(mut file: Vec<u8>, method: Method) -> Vec<u8> {
    file[25..28].copy_from_slice(&method.encode());
    repair(&mut file);
    file
}

/// The model of [`sections`].
pub fn model() -> Vec<u8> {
    assemble(&sections())
}

/// A model whose scan and classifier keep everything.
pub fn keen_model() -> Vec<u8> {
    let mut sections = sections();
    for (section, features) in [(Section::Scan, 1), (Section::Cube, 40)] {
        let leaves = vec![-3, 5, 2, 9];
        let tree = (NEVER_REJECT, vec![(0, 100), (0, 50), (0, 150)], leaves);
        sections[section as usize] = forest(features, 0, &[tree]);
    }
    assemble(&sections)
}

/// Memory for a detector, filled with `dirt`.
pub fn memory(config: &Config, dirt: u8) -> (Vec<u8>, Vec<u16>) {
    (vec![dirt; config.bytes_len()], vec![u16::from(dirt) * 257; config.words_len()])
}

/// Detections of `count` frames drawn by [`golden::draw`].
pub fn watch(model: &[u8], config: Config, dirt: u8, count: u32) -> Vec<Detections> {
    let (mut bytes, mut words) = memory(&config, dirt);
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&Model::parse(model).unwrap(), config, buffers).unwrap();
    look(&mut detector, config, 0, count)
}

/// Detections of frames `first..first + count` drawn by [`golden::draw`].
pub fn look(
    detector: &mut Detector<'_, '_>,
    config: Config,
    first: u32,
    count: u32,
) -> Vec<Detections> {
    let mut pixels = vec![0; config.width * config.height];
    (first..first + count)
        .map(|number| {
            golden::draw(number, config.width, &mut pixels);
            let frame = Image::packed(&pixels, config.width, config.height).unwrap();
            let mut detections = Detections::default();
            detector.process(frame, i64::from(number) * 33_333, &mut detections).unwrap();
            detections
        })
        .collect()
}
