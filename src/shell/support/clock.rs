//! The clock of everything live: that of the camera's frames.

/// Microseconds of the system's monotonic clock, which cameras stamp their frames with.
pub fn now_us() -> i64 {
    #[cfg(target_os = "linux")]
    {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        now.tv_sec * 1_000_000 + now.tv_nsec / 1000
    }
    #[cfg(not(target_os = "linux"))]
    {
        static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
        START.get_or_init(std::time::Instant::now).elapsed().as_micros() as i64
    }
}

/// Microseconds since 1970, as the system's clock has it; 0 before.
pub fn unix_us() -> i64 {
    let unix = std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
    i64::try_from(unix.as_micros()).unwrap_or(0)
}

/// [`unix_us`] less [`now_us`].
pub fn unix_offset_us() -> i64 {
    unix_us() - now_us()
}
