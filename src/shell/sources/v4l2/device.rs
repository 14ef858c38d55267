//! A video node of the kernel and the buffers it fills: every request, and all that is unsafe about them.
#![expect(unsafe_code, reason = "requests to the kernel, and memory shared with it")]

use super::abi::*;
use core::ptr::{self, NonNull};
use core::slice;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags};
use rustix::io::{Errno, Result, retry_on_intr};
use rustix::ioctl::{Opcode, Updater, ioctl};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::path::Path;
use std::time::Duration;
use std::vec::Vec;

/// An open video node. All its calls give the kernel's own error numbers.
#[derive(Debug)]
pub struct Device(OwnedFd);

impl Device {
    pub fn open(path: &Path) -> Result<Self> {
        // Never waits in a request; programs that are started later do not hold the camera.
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
        retry_on_intr(|| rustix::fs::open(path, flags, Mode::empty())).map(Self)
    }

    /// `OPCODE` is a number of `abi` made for `T`, a structure there that holds no pointer but those of
    /// [`ControlValues`].
    fn request<const OPCODE: Opcode, T>(&self, value: &mut T) -> Result<()> {
        const { assert!((OPCODE >> 16) as usize & 0x3fff == size_of::<T>()) };
        // SAFETY: the kernel reads and writes as many bytes as the number says, which are those of `T`; any bytes are
        // a valid `T`, which has integers and one raw pointer at most. What that pointer stands for is up to
        // `control_values`, the only place that sets it.
        retry_on_intr(|| unsafe { ioctl(&self.0, Updater::<OPCODE, T>::new(value)) })
    }

    pub fn capability(&self) -> Result<Capability> {
        let mut capability = Capability::default();
        self.request::<QUERYCAP, _>(&mut capability)?;
        Ok(capability)
    }

    /// The format of that index, from 0; [`Errno::INVAL`] after the last.
    pub fn format_description(&self, index: u32) -> Result<FormatDescription> {
        let mut format = FormatDescription { index, kind: CAPTURE, ..Default::default() };
        self.request::<ENUM_FMT, _>(&mut format)?;
        Ok(format)
    }

    /// Sets a format; the driver changes what it cannot do.
    pub fn set_format(&self, fourcc: [u8; 4], width: u32, height: u32) -> Result<Format> {
        let (kind, field) = (CAPTURE, PROGRESSIVE);
        let mut format = Format { kind, field, fourcc, width, height, ..Default::default() };
        self.request::<S_FMT, _>(&mut format)?;
        Ok(format)
    }

    /// Parameters of the stream, its frame interval among them.
    pub fn stream_parameters(&self) -> Result<StreamParameters> {
        let mut parameters = StreamParameters { kind: CAPTURE, ..Default::default() };
        self.request::<G_PARM, _>(&mut parameters)?;
        Ok(parameters)
    }

    /// Asks for `rate` frames a second; the driver takes the nearest it can do.
    pub fn set_rate(&self, rate: u32) -> Result<StreamParameters> {
        let (numerator, denominator) = (1, rate);
        let mut parameters =
            StreamParameters { kind: CAPTURE, numerator, denominator, ..Default::default() };
        self.request::<S_PARM, _>(&mut parameters)?;
        Ok(parameters)
    }

    /// The control after that of `id`; [`Errno::INVAL`] after the last.
    pub fn control_after(&self, id: u32) -> Result<ControlQuery> {
        let mut query = ControlQuery { id: id | ControlQuery::NEXT, ..Default::default() };
        self.request::<QUERY_EXT_CTRL, _>(&mut query)?;
        Ok(query)
    }

    pub fn control(&self, id: u32) -> Result<[u8; 8]> {
        let mut value = ControlValue { id, ..Default::default() };
        self.control_values::<G_EXT_CTRLS>(&mut value)?;
        Ok(value.value)
    }

    pub fn set_control(&self, id: u32, value: [u8; 8]) -> Result<()> {
        self.control_values::<S_EXT_CTRLS>(&mut ControlValue { id, value, ..Default::default() })
    }

    fn control_values<const OPCODE: Opcode>(&self, value: &mut ControlValue) -> Result<()> {
        // The kernel follows this pointer during the request, to one control as `count` says, and none within it:
        // `size` is 0, so that the value is no pointer.
        let controls = ptr::from_mut(value);
        self.request::<OPCODE, _>(&mut ControlValues::one(controls))
    }

    /// Waits for a filled buffer or trouble; no events when the time is over.
    pub fn wait(&self, timeout: Duration) -> Result<PollFlags> {
        let mut events = [PollFd::new(&self.0, PollFlags::IN)];
        let timeout = Timespec::try_from(timeout).map_err(|_| Errno::INVAL)?;
        match poll(&mut events, Some(&timeout)) {
            // A signal: the caller looks at the clock and waits again.
            Ok(_) | Err(Errno::INTR) => Ok(events[0].revents()),
            Err(error) => Err(error),
        }
    }
}

/// A streaming device and the buffers it fills.
#[derive(Debug)]
pub struct DeviceStream {
    device: Device,
    buffers: Vec<Mapping>,
}

impl DeviceStream {
    /// Maps about `count` buffers (the driver decides), gives it all of them and starts it.
    pub fn start(device: Device, count: u32) -> Result<Self> {
        let mut request =
            RequestBuffers { count, kind: CAPTURE, memory: MMAP, ..Default::default() };
        device.request::<REQBUFS, _>(&mut request)?;
        let mut stream = Self { device, buffers: Vec::new() };
        for index in 0..request.count {
            let mut buffer = Buffer::mapped(index);
            stream.device.request::<QUERYBUF, _>(&mut buffer)?;
            let (length, offset) = (buffer.length as usize, buffer.offset.into());
            stream.buffers.push(Mapping::new(&stream.device, length, offset)?);
            stream.device.request::<QBUF, _>(&mut buffer)?;
        }
        stream.device.request::<STREAMON, u32>(&mut { CAPTURE })?;
        Ok(stream)
    }

    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The oldest filled buffer, [`Errno::AGAIN`] when there is none.
    pub fn dequeue(&self) -> Result<Filled<'_>> {
        let mut buffer = Buffer::mapped(0);
        self.device.request::<DQBUF, _>(&mut buffer)?;
        let mapping = self.buffers.get(buffer.index as usize).ok_or(Errno::IO)?;
        Ok(Filled { device: &self.device, buffer, mapping })
    }
}

impl Drop for DeviceStream {
    fn drop(&mut self) {
        // A device that is gone has stopped already.
        let _ = self.device.request::<STREAMOFF, u32>(&mut { CAPTURE });
    }
}

/// A buffer that the driver has filled and lent to us; dropped, it goes back.
#[derive(Debug)]
pub struct Filled<'a> {
    device: &'a Device,
    buffer: Buffer,
    mapping: &'a Mapping,
}

impl Filled<'_> {
    pub fn buffer(&self) -> &Buffer {
        &self.buffer
    }

    /// Bytes that the driver wrote.
    pub fn bytes(&self) -> &[u8] {
        let length = self.mapping.length.min(self.buffer.bytes_used as usize);
        // SAFETY: the mapping lives as long as `self` and has at least `length` bytes. Between DQBUF and QBUF, which
        // is the life of `self`, the driver does not write to the buffer; nobody else has it.
        unsafe { slice::from_raw_parts(self.mapping.start.as_ptr(), length) }
    }
}

impl Drop for Filled<'_> {
    fn drop(&mut self) {
        // Fails when the device is gone, which the next wait reports.
        let _ = self.device.request::<QBUF, _>(&mut Buffer::mapped(self.buffer.index));
    }
}

/// The memory of one buffer.
#[derive(Debug)]
struct Mapping {
    start: NonNull<u8>,
    length: usize,
}

// SAFETY: the memory belongs to the process, and is only read, by who holds the buffer.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(device: &Device, length: usize, offset: u64) -> Result<Self> {
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: the kernel chooses the place, so that no memory in use is replaced.
        let start = unsafe {
            mmap(ptr::null_mut(), length, protection, MapFlags::SHARED, &device.0, offset)
        }?;
        Ok(Self { start: NonNull::new(start.cast()).ok_or(Errno::NOMEM)?, length })
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: it was mapped by `new` with this length; no slice of it outlives `self`.
        let _ = unsafe { munmap(self.start.as_ptr().cast(), self.length) };
    }
}
