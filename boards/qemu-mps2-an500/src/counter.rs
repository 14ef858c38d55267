//! Instructions, counted by the clock of QEMU: `-icount shift=0` lets one nanosecond pass with each.

use cortex_m::asm;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// Instructions in a tick of SysTick, which runs at the board's 25 MHz.
const INSTRUCTIONS_A_TICK: u64 = 40;

/// The most that SysTick counts.
const TICKS: u32 = (1 << 24) - 1;

/// Instructions of the loop by which it is tried whether the clock counts them.
const TRIED: u32 = 1_000_000;

/// SysTick.
pub struct Counter {
    timer: SYST,
    last: u32,
}

impl Counter {
    /// Switches it on. `None` when the clock does not count instructions.
    pub fn new(mut timer: SYST) -> Option<Self> {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(TICKS);
        timer.clear_current();
        timer.enable_counter();
        let mut counter = Self { timer, last: 0 };
        counter.lap();
        // A loop of two instructions.
        asm::delay(TRIED / 2);
        let counted = counter.lap();
        counted
            .is_some_and(|n| n.abs_diff(u64::from(TRIED)) < u64::from(TRIED / 100))
            .then_some(counter)
    }

    /// Instructions since the last call. `None` when they are more than SysTick can count, 671 million.
    pub fn lap(&mut self) -> Option<u64> {
        let now = SYST::get_current();
        let ticks = self.last.wrapping_sub(now) & TICKS;
        // It counts down; once around it is before the last place again.
        let around = self.timer.has_wrapped() && now <= self.last;
        self.last = now;
        (!around).then_some(u64::from(ticks) * INSTRUCTIONS_A_TICK)
    }
}
