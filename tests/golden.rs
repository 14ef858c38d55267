//! The same detections on every machine and in every build: debug, release, with and without `rayon`.

mod common;

use common::golden::{CONFIG, DIGEST, FRAMES, MODEL, digest};
use lookout::channels::method::{Alignment, Method};
use lookout::detector::{Buffers, Config};

#[test]
fn the_model_is_the_one_put_together_by_hand() {
    let model = common::model();
    if MODEL != model {
        let path = concat!(env!("CARGO_TARGET_TMPDIR"), "/golden.lkm");
        std::fs::write(path, &model).unwrap();
        panic!("tests/common/golden.lkm differs from what common::model() gives: see {path}");
    }
}

#[test]
fn digest_of_the_detections() {
    let (mut bytes, mut words) = common::memory(&CONFIG, 0);
    let mut pixels = vec![0; CONFIG.width * CONFIG.height];
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let (digest, found) = digest(buffers, &mut pixels).unwrap();
    assert!(found > FRAMES as usize, "only {found} detections: the digest would say little");
    assert_eq!(digest, DIGEST, "{digest:#010x} from {found} detections");
}

#[test]
fn every_part_has_a_say_in_the_digest() {
    let parts = |method| Config { method, ..CONFIG };
    let runs = common::watch(MODEL, CONFIG, 0, FRAMES);
    assert!(runs.iter().filter(|d| d.registered).count() > FRAMES as usize / 2);
    assert!(runs.iter().any(|d| d.dropped > 0));
    for other in [
        parts(Method { registration: false, ..CONFIG.method }),
        parts(Method { temporal: false, ..CONFIG.method }),
        parts(Method { alignment: Alignment::Background, ..CONFIG.method }),
        parts(Method { stcube: false, ..CONFIG.method }),
        Config { fit: false, ..CONFIG },
    ] {
        assert_ne!(common::watch(MODEL, other, 0, FRAMES), runs, "{other:?}");
    }
}
