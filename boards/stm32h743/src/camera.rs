//! The camera: sensor, parallel port (DCMI) and DMA, in a task of its own that interrupts the detector.

use crate::frames::Frame;
use crate::sensor;
use embassy_stm32::dcmi::Dcmi;
use embassy_stm32::gpio::Output;
use embassy_stm32::i2c::{I2c, Master};
use embassy_stm32::mode::Blocking;
use embassy_stm32::pac::DCMI;
use embassy_stm32::peripherals;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::Sender;
use embassy_time::{Instant, Timer};

/// How long a sensor that does not answer is left alone.
const PAUSE_MS: u64 = 1000;

/// Field BSM of DCMI_CR, which the crate does not name: bytes are taken by turns, the first one (OEBS is 0 after a reset), so
/// luma alone. Source: ST RM0433, DCMI control register.
const EVERY_OTHER_BYTE: u32 = 1 << 16;

/// What the camera is made of.
pub struct Camera {
    /// The sensor's control port.
    pub bus: I2c<'static, Blocking, Master>,
    /// Low resets it.
    pub reset: Output<'static>,
    /// High switches it off.
    pub power_down: Output<'static>,
    /// The parallel port.
    pub port: Dcmi<'static, peripherals::DCMI>,
}

/// Takes frame after frame, as soon as there is room for one.
#[embassy_executor::task]
pub async fn run(camera: Camera, mut frames: Sender<'static, CriticalSectionRawMutex, Frame>) {
    let Camera { mut bus, mut reset, mut power_down, mut port } = camera;
    power_down.set_low();
    loop {
        reset.set_low();
        Timer::after_millis(10).await;
        reset.set_high();
        Timer::after_millis(10).await;
        if sensor::start(&mut bus).await.is_ok() {
            break;
        }
        // Without frames the component says that it is not watching.
        Timer::after_millis(PAUSE_MS).await;
    }
    DCMI.cr().modify(|r| r.0 |= EVERY_OTHER_BYTE);
    loop {
        let frame = frames.send().await;
        // A frame that was not whole is left out.
        if port.capture(frame.words_mut()).await.is_ok() {
            frame.time_us = Instant::now().as_micros() as i64;
            frames.send_done();
        }
    }
}
