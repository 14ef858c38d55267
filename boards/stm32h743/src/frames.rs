//! Frames, from the camera's DMA to the detector: while one is looked at the next one is taken.
#![expect(unsafe_code, reason = "memory that only the DMA writes, behind the data cache")]

use core::mem::MaybeUninit;
use cortex_m::peripheral::SCB;
use embassy_stm32::pac::RCC;
use firmware::CONFIG;

/// Bytes of a line of the data cache.
const LINE: usize = 32;

/// Words of a frame, a byte a pixel.
const WORDS: usize = CONFIG.width * CONFIG.height / 4;

// A line of the cache is of one frame only.
const _: () = assert!(WORDS * 4 % LINE == 0 && align_of::<Frame>() == LINE);

/// One frame.
#[repr(C, align(32))]
pub struct Frame {
    words: [u32; WORDS],
    /// When its last pixel came, in microseconds.
    pub time_us: i64,
}

impl Frame {
    /// For the DMA.
    pub fn words_mut(&mut self) -> &mut [u32] {
        &mut self.words
    }

    /// The pixels that the DMA has written, row by row.
    pub fn pixels(&mut self, scb: &mut SCB) -> &[u8] {
        // SAFETY: the processor writes none of the words while the cache is on, so none of them waits in it to be
        // written back, and the lines are of these words alone.
        unsafe { scb.invalidate_dcache_by_slice(&mut self.words) };
        bytemuck::cast_slice(&self.words)
    }
}

/// Room for frames. To be called once, before the data cache is switched on.
pub fn take() -> &'static mut [Frame; 2] {
    #[unsafe(link_section = ".frames")]
    static mut ROOM: MaybeUninit<[Frame; 2]> = MaybeUninit::uninit();
    // SRAM1 and SRAM2 have no clock after a reset.
    RCC.ahb2enr().modify(|r| {
        r.set_sram1en(true);
        r.set_sram2en(true);
    });
    let none = || Frame { words: [0; WORDS], time_us: 0 };
    let room = &raw mut ROOM;
    // SAFETY: `main` calls this once, so that this is the only reference.
    unsafe { (*room).write([none(), none()]) }
}
