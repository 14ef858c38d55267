//! How much memory the program uses: statics by the linker's word, the stack by what is left of the paint that
//! `cortex-m-rt` puts on it before `main`.
#![expect(unsafe_code, reason = "places that only the linker knows")]

use core::ptr::addr_of;

/// What `cortex-m-rt` paints with.
const PAINT: u32 = cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static __sdata: u32;
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Bytes of all statics.
pub fn statics() -> usize {
    let (start, end) = (addr_of!(__sdata), addr_of!(_stack_end));
    end as usize - start as usize
}

/// Bytes of the stack that were in use at any time until now.
pub fn stack() -> usize {
    let (end, start) = (addr_of!(_stack_end), addr_of!(_stack_start));
    let mut lowest = end;
    // SAFETY: all words between are memory of the stack's; they are read past the compiler, which may be writing some.
    while lowest < start && unsafe { lowest.read_volatile() } == PAINT {
        lowest = lowest.wrapping_add(1);
    }
    start as usize - lowest as usize
}
