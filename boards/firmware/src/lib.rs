//! The lookout as firmware: frames and bytes of a serial line in, bytes for that line out. A board adds memory, a camera
//! and a line; it has no operating system, and nothing here allocates.
#![no_std]

mod feed;

use feed::Feed;
use lookout::camera::Camera;
use lookout::detector::{self, Buffers, Config, Detections, Detector, DetectorStage};
use lookout::image::Image;
use lookout::mavlink::component::Trust;
use lookout::mavlink::component::parameters::Parameters;
use lookout::mavlink::dialect::ArduPilotFrames;
use lookout::mavlink::lookout::Lookout;
use lookout::model::{Method, Model, ModelError};
use lookout::tracking::tracker;
use mavlink_core::MavlinkReader;
use static_cell::{ConstStaticCell, StaticCell};

/// The model in flash.
pub const MODEL: &[u8] = include_bytes!("../../../models/lookout-mini.lkm");

/// Frames of 320x240, the parts of [`MODEL`]: what a board's memory is made for.
pub const CONFIG: Config = match Method::of_header(MODEL) {
    Some(method) => Config::for_method(method, 320, 240),
    None => panic!("models/lookout-mini.lkm names no method"),
};

/// How long before a frame that was taken messages wait at most, in microseconds.
pub const TICK_US: i64 = 20_000;

/// The only link, the serial line.
const LINE: u8 = 0;

/// The detector's memory.
struct Memory {
    bytes: [u8; CONFIG.bytes_len()],
    words: [u16; CONFIG.words_len()],
}

/// Why the lookout cannot start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// The model in flash is damaged.
    Model(ModelError),
    /// The model was trained with parts that [`CONFIG`] has no memory for.
    Memory(detector::Error),
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Model(error) => write!(f, "the model in flash: {error}"),
            Self::Memory(error) => write!(f, "the memory laid out for the detector: {error}"),
        }
    }
}

impl core::error::Error for Error {}

/// The lookout on a board.
pub struct Firmware {
    detector: Detector<'static, 'static>,
    /// Of the last frame: four kilobytes, which a small stack has no room for.
    detections: Detections,
    onboard: Lookout,
    reader: MavlinkReader<Feed>,
    /// Number of the next frame of MAVLink, of each component that speaks.
    sequences: [u8; 256],
}

impl Firmware {
    /// The one that there is, which has seen and heard nothing yet. Times are microseconds of one clock, here and below.
    /// Panics when called again.
    ///
    /// # Errors
    /// [`Error`], when the firmware was built wrongly.
    // What is copied while it is made must not stay on the stack of the caller, who never returns.
    #[inline(never)]
    pub fn start(camera: Camera, now_us: i64) -> Result<&'static mut Self, Error> {
        static MEMORY: ConstStaticCell<Memory> = ConstStaticCell::new(Memory {
            bytes: [0; CONFIG.bytes_len()],
            words: [0; CONFIG.words_len()],
        });
        static FIRMWARE: StaticCell<Firmware> = StaticCell::new();
        let model = Model::parse(MODEL).map_err(Error::Model)?;
        let Memory { bytes, words } = MEMORY.take();
        let buffers = Buffers { bytes, words };
        let detector = Detector::new(&model, CONFIG, buffers).map_err(Error::Memory)?;
        let tracks = tracker::TrackerSettings::calibrated(model.calibration());
        let firmware = FIRMWARE.init_with(|| Self {
            detector,
            detections: Detections::default(),
            onboard: Lookout::new(
                camera,
                tracks,
                Default::default(),
                Parameters::default(),
                now_us,
            ),
            reader: MavlinkReader::new(Feed::new()),
            sequences: [0; 256],
        });
        Ok(firmware)
    }

    /// Hears bytes that came over the line until `now_us`.
    pub fn hear(&mut self, mut bytes: &[u8], now_us: i64) {
        while !bytes.is_empty() {
            bytes = self.reader.get_mut().fill(bytes);
            // An error says only that the bytes are at their end; half a frame stays in the reader.
            while let Ok(frame) = self.reader.read_any_raw_message_with_dialect(&ArduPilotFrames) {
                self.onboard.receive(LINE, &frame, Trust::Open, now_us);
            }
        }
    }

    /// Looks at a frame taken at `time_us`; `observer` hears of each stage as it ends, `clock` gives the time after the last.
    ///
    /// # Errors
    /// [`detector::Error`] when the frame has another size than [`CONFIG`]; it is left out.
    pub fn see(
        &mut self,
        frame: Image<'_>,
        time_us: i64,
        observer: &mut dyn FnMut(DetectorStage),
        clock: impl FnOnce() -> i64,
    ) -> Result<&Detections, detector::Error> {
        let Self { detector, detections, onboard, .. } = self;
        detector.process_observed(frame, time_us, detections, observer)?;
        onboard.process(detections, time_us, clock());
        Ok(detections)
    }

    /// Writes what there is to say, frame by frame; to be called every [`TICK_US`] or so.
    pub fn speak(&mut self, now_us: i64, mut write: impl FnMut(&[u8])) {
        while let Some(message) = self.onboard.poll(now_us) {
            let (system, component) = (message.system_id, message.component_id);
            let sequence = &mut self.sequences[usize::from(component)];
            write(message.payload.frame(system, component, *sequence, false).raw_bytes());
            *sequence = sequence.wrapping_add(1);
        }
    }
}
