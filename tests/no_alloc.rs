//! The detector allocates nothing once it is made.

mod common;

use lookout::detector::{Buffers, Config, Detections, Detector};
use lookout::image::Image;
use lookout::model::Model;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// Counts what each thread asks of the system's allocator.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

#[expect(unsafe_code, reason = "a global allocator is an unsafe trait")]
// SAFETY: every call is passed on unchanged to the system's allocator, which keeps the contract.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promises are those that `System` asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `System` with this layout, through `alloc` above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations during 12 frames, and detections and windows kept.
fn watch(model: &[u8]) -> (usize, usize, u32) {
    let model = Model::parse(model).unwrap();
    let config = Config::for_model(&model, 320, 240);
    let (mut bytes, mut words) = common::memory(&config, 0);
    let mut detections = Detections::default();
    let mut pixels = vec![0; config.width * config.height];
    let buffers = Buffers { bytes: &mut bytes, words: &mut words };
    let mut detector = Detector::new(&model, config, buffers).unwrap();
    let before = COUNT.get();
    let (mut found, mut kept) = (0, 0);
    for number in 0..12 {
        common::golden::draw(number, config.width, &mut pixels);
        let frame = Image::packed(&pixels, config.width, config.height).unwrap();
        detector.process(frame, i64::from(number) * 33_333, &mut detections).unwrap();
        found += detections.list.len();
        kept += detections.kept;
    }
    (COUNT.get() - before, found, kept)
}

/// Runs `work` on one thread: several threads would allocate to talk to each other.
fn alone<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    #[cfg(feature = "rayon")]
    return rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(work);
    #[cfg(not(feature = "rayon"))]
    work()
}

#[test]
fn nothing_is_allocated_after_the_start() {
    let (shipped, ..) = alone(|| watch(include_bytes!("../models/lookout.lkm")));
    assert_eq!(shipped, 0, "allocations with the shipped model");
    let (own, found, kept) = alone(|| watch(&common::model()));
    assert_eq!(own, 0, "allocations with a model of {kept} candidates, {found} detections");
    assert!(found > 0 && kept > 0, "the scene reached no cube");
    assert!(alone(|| (vec![1], COUNT.get())).1 > 0, "the allocator does not count");
}
