//! The OV7725 sensor of the OpenMV Cam H7: 320x240 at 30 frames a second, luma in every other byte.
//! Source of registers and clocks: Linux, drivers/media/i2c/ov772x.c (commit 010e85f), which names them after OmniVision's
//! datasheet of the OV7725.

use embassy_stm32::i2c::{Error as BusError, I2c, Master};
use embassy_stm32::mode::Blocking;
use embassy_time::Timer;

/// Its address on the SCCB, which is I2C but for reads without a repeated start.
const ADDRESS: u8 = 0x21;

/// Registers of the product's number and version.
const PRODUCT: [u8; 2] = [0x0A, 0x0B];
/// What they hold.
const OV7725: [u8; 2] = [0x77, 0x21];

/// COM7, with all registers back at their defaults: exposure, gain and white balance are the sensor's own work there.
const RESET: (u8, u8) = (0x12, 0x80);

/// What is not as after a reset.
const SETUP: [(u8, u8); 12] = [
    // COM7: half resolution, YUV 4:2:2.
    (0x12, 0x40),
    // COM3: luma before chroma.
    (0x0C, 0x10),
    // COM4, CLKRC: 12 MHz times 4, divided by 5: 576 x 278 pixels of two bytes, blanking included, 30 times a second.
    (0x0D, 0x41),
    (0x11, 0x84),
    // HSTART, HSIZE, VSTRT, VSIZE: the part of the array that is read, in units of 4, 4, 2 and 2 pixels: 320 from 252 on in
    // each row, 240 rows from the sixth on.
    (0x17, 63),
    (0x18, 80),
    (0x19, 3),
    (0x1A, 120),
    // HREF, HOUTSIZE, VOUTSIZE: what is left of those numbers, and what is sent of the part.
    (0x32, 0x00),
    (0x29, 80),
    (0x2C, 120),
    // EXHCH: what is left of those.
    (0x2A, 0x00),
];

/// The sensor does not answer, or another one does.
#[derive(Debug)]
pub struct Missing;

impl From<BusError> for Missing {
    fn from(_: BusError) -> Self {
        Self
    }
}

/// Lets the sensor, whose clock runs, send frames.
///
/// # Errors
/// [`Missing`]; the sensor may be half set up.
pub async fn start(bus: &mut I2c<'_, Blocking, Master>) -> Result<(), Missing> {
    let mut product = [0; 2];
    for (register, value) in PRODUCT.iter().zip(product.chunks_exact_mut(1)) {
        bus.blocking_write(ADDRESS, &[*register])?;
        bus.blocking_read(ADDRESS, value)?;
    }
    if product != OV7725 {
        return Err(Missing);
    }
    bus.blocking_write(ADDRESS, &[RESET.0, RESET.1])?;
    Timer::after_millis(5).await;
    for (register, value) in SETUP {
        bus.blocking_write(ADDRESS, &[register, value])?;
    }
    Ok(())
}
