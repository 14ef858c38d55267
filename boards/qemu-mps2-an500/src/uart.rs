//! UART 0 of the board, as far as sending goes.
//! Source: Arm DUI 0479, Cortex-M System Design Kit Technical Reference Manual, section 4.3 (APB UART).
#![expect(unsafe_code, reason = "registers of the UART")]

/// UART 0 on the board.
const BASE: usize = 0x4000_4000;
const DATA: *mut u32 = BASE as *mut u32;
const STATE: *const u32 = (BASE + 4) as *const u32;
const CONTROL: *mut u32 = (BASE + 8) as *mut u32;
const DIVIDER: *mut u32 = (BASE + 16) as *mut u32;

/// Bit of [`STATE`]: a byte waits to be sent.
const FULL: u32 = 1;
/// Bit of [`CONTROL`].
const SEND: u32 = 1;
/// 25 MHz / 115 200 bits a second.
const BITS: u32 = 217;

/// The sending half of UART 0.
#[derive(Debug)]
pub struct Uart(());

impl Uart {
    /// Switches it on. There is to be one only, else frames are mixed.
    pub fn new() -> Self {
        // SAFETY: both are registers of UART 0, which nothing else touches.
        unsafe {
            DIVIDER.write_volatile(BITS);
            CONTROL.write_volatile(SEND);
        }
        Self(())
    }

    /// Sends all bytes.
    pub fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            // SAFETY: as above; a byte is given only when there is room for it.
            unsafe {
                while STATE.read_volatile() & FULL != 0 {}
                DATA.write_volatile(u32::from(*byte));
            }
        }
    }
}
