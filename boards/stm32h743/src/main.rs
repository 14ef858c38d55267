//! The firmware on an STM32H743, wired as the OpenMV Cam H7 is: OV7725 on the parallel port, autopilot on USART 3.
//! Source of the wiring: OpenMV, boards/OPENMV4/omv_boardconfig.h (commit 15f8e0d).
#![no_std]
#![no_main]

mod camera;
mod clocks;
mod frames;
mod sensor;

use camera::Camera;
use embassy_executor::{InterruptExecutor, Spawner};
use embassy_futures::select::{Either, select};
use embassy_stm32::dcmi::{self, Dcmi};
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::i2c::{self, I2c};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::rcc::{Mco, Mco1Source, McoConfig};
use embassy_stm32::usart::{self, BufferedUart};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, dma, peripherals};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::zerocopy_channel::Channel;
use embassy_time::{Duration, Instant, Timer};
use embedded_io::Write;
use firmware::{CONFIG, Firmware, TICK_US};
use frames::Frame;
use lookout::math::real::{PI, Real};
use lookout::image::Image;
use panic_reset as _;
use static_cell::{ConstStaticCell, StaticCell};

/// Horizontal field of view of the lens that the camera comes with, 70.8 degrees in radians.
const VIEW: Real = PI.strict_mul_int(708).strict_div_int(1800);

/// Bits a second to the autopilot.
const BAUD: u32 = 115_200;

/// Bytes that wait to be sent, and that came while a frame was looked at.
const WAITING: usize = 4096;

/// The board starts anew when nothing happens for so long.
const WATCHDOG_US: u32 = 4_000_000;

bind_interrupts!(struct Interrupts {
    DCMI => dcmi::InterruptHandler<peripherals::DCMI>;
    DMA2_STREAM1 => dma::InterruptHandler<peripherals::DMA2_CH1>;
    USART3 => usart::BufferedInterruptHandler<peripherals::USART3>;
});

/// Runs the camera; the interrupt is of a port that the board does not use.
static CAMERA: InterruptExecutor = InterruptExecutor::new();

#[allow(unsafe_code, reason = "an interrupt's handler")]
#[interrupt]
unsafe fn LPUART1() {
    // SAFETY: this is the handler that `CAMERA` was started with.
    unsafe { CAMERA.on_interrupt() }
}

fn now_us() -> i64 {
    Instant::now().as_micros() as i64
}

#[embassy_executor::main]
async fn main(_spawner: Spawner) -> ! {
    static FRAMES: StaticCell<Channel<'_, CriticalSectionRawMutex, Frame>> = StaticCell::new();
    static SENT: ConstStaticCell<[u8; WAITING]> = ConstStaticCell::new([0; WAITING]);
    static HEARD: ConstStaticCell<[u8; WAITING]> = ConstStaticCell::new([0; WAITING]);

    let p = embassy_stm32::init(clocks::config());
    let (sender, mut frames) = FRAMES.init(Channel::new(frames::take())).split();
    let mut core = cortex_m::Peripherals::take().expect("nobody took them before");
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);

    let _sensor_clock = Mco::new(p.MCO1, p.PA8, Mco1Source::HSE, McoConfig::default());
    let camera = Camera {
        bus: I2c::new_blocking(p.I2C1, p.PB8, p.PB9, i2c::Config::default()),
        reset: Output::new(p.PA10, Level::Low, Speed::Low),
        power_down: Output::new(p.PD7, Level::High, Speed::Low),
        port: Dcmi::new_8bit(
            p.DCMI,
            p.DMA2_CH1,
            Interrupts,
            p.PC6,
            p.PC7,
            p.PE0,
            p.PE1,
            p.PE4,
            p.PB6,
            p.PE5,
            p.PE6,
            p.PB7,
            p.PA4,
            p.PA6,
            dcmi::Config::default(),
        ),
    };
    interrupt::LPUART1.set_priority(Priority::P6);
    CAMERA.start(interrupt::LPUART1).spawn(camera::run(camera, sender).expect("it runs once"));

    let mut settings = usart::Config::default();
    settings.baudrate = BAUD;
    let line = BufferedUart::new(
        p.USART3,
        p.PB11,
        p.PB10,
        SENT.take(),
        HEARD.take(),
        Interrupts,
        settings,
    );
    let mut line = line.expect("the rate is one that USART 3 has");
    let view = lookout::camera::Camera::from_field_of_view(
        CONFIG.width as u32,
        CONFIG.height as u32,
        VIEW,
    );
    let view = view.expect("an angle that a lens has");
    let lookout = Firmware::start(view, now_us()).expect("tried before it was flashed");
    let mut watchdog = IndependentWatchdog::new(p.IWDG1, WATCHDOG_US);
    watchdog.unleash();
    loop {
        watchdog.pet();
        let tick = Timer::after(Duration::from_micros(TICK_US.unsigned_abs()));
        if let Either::First(frame) = select(frames.receive(), tick).await {
            let time_us = frame.time_us;
            if let Ok(frame) =
                Image::packed(frame.pixels(&mut core.SCB), CONFIG.width, CONFIG.height)
            {
                // Frames are of the size that the detector was made for.
                let _ = lookout.see(frame, time_us, &mut |_| {}, now_us);
            }
            frames.receive_done();
        }
        let mut bytes = [0; 64];
        while let Ok(number @ 1..) = embedded_io::Read::read(&mut line, &mut bytes) {
            lookout.hear(&bytes[..number], now_us());
        }
        // A line that fails is the autopilot's to notice; there is no other to say it on.
        lookout.speak(now_us(), |bytes| line.write_all(bytes).unwrap_or_default());
    }
}
