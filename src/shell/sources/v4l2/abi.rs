//! The kernel's structures and request numbers for video capture.
//!
//! Names and layout are those of `linux/videodev2.h`, which never change; only what is used here is written out. They differ
//! between systems of 32 and 64 bits where the kernel's structure holds a pointer: there it is as large and as aligned as
//! one. Times are of 64 bits on both, which Linux has from 5.6 on (a structure of another size, so another request number).

use rustix::ioctl::{Opcode, opcode};

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE`: pictures in one plane.
pub const CAPTURE: u32 = 1;
/// `V4L2_MEMORY_MMAP`: buffers of the driver, mapped by the program.
pub const MMAP: u32 = 1;
/// `V4L2_FIELD_NONE`: whole pictures, not every second line.
pub const PROGRESSIVE: u32 = 1;
/// `V4L2_FIELD_ANY`: what a driver leaves that does not know fields.
pub const ANY_FIELD: u32 = 0;
/// `V4L2_FIELD_INTERLACED`: both fields in one picture, the top one being the earlier one except in NTSC.
pub const INTERLACED: u32 = 4;
/// `V4L2_FIELD_INTERLACED_TB`: the same, top field first.
pub const INTERLACED_TOP: u32 = 8;
/// `V4L2_FIELD_INTERLACED_BT`: the same, bottom field first.
pub const INTERLACED_BOTTOM: u32 = 9;

/// Padding behind a four-byte field where the system's pointers have eight: four bytes, or none.
#[cfg(target_pointer_width = "64")]
pub type Gap = u32;
#[cfg(target_pointer_width = "32")]
pub type Gap = [u32; 0];

/// `v4l2_capability`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct Capability {
    pub driver: [u8; 16],
    pub card: [u8; 32],
    pub bus_info: [u8; 32],
    pub version: u32,
    pub capabilities: u32,
    pub device_caps: u32,
    pub reserved: [u32; 3],
}

impl Capability {
    pub const VIDEO_CAPTURE: u32 = 0x1;
    pub const STREAMING: u32 = 0x0400_0000;
    const DEVICE_CAPS: u32 = 0x8000_0000;

    /// Capabilities of this node, of all nodes of the device.
    pub fn of_node(&self) -> u32 {
        if self.capabilities & Self::DEVICE_CAPS == 0 {
            self.capabilities
        } else {
            self.device_caps
        }
    }
}

/// `v4l2_fmtdesc`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct FormatDescription {
    pub index: u32,
    pub kind: u32,
    pub flags: u32,
    pub description: [u8; 32],
    pub fourcc: [u8; 4],
    pub mbus_code: u32,
    pub reserved: [u32; 3],
}

/// `v4l2_format` with its `v4l2_pix_format`. Others of its formats hold pointers.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct Format<G = Gap> {
    pub kind: u32,
    pub padding: G,
    pub width: u32,
    pub height: u32,
    pub fourcc: [u8; 4],
    pub field: u32,
    pub bytes_per_line: u32,
    pub size_image: u32,
    pub colorspace: u32,
    pub private: u32,
    pub flags: u32,
    pub encoding: u32,
    pub quantization: u32,
    pub transfer: u32,
    pub rest: [[u32; 19]; 2],
}

impl Format {
    pub const COLORSPACE_JPEG: u32 = 7;
    pub const FULL_RANGE: u32 = 1;
    pub const LIMITED_RANGE: u32 = 2;
}

/// `v4l2_streamparm` with its `v4l2_captureparm`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct StreamParameters {
    pub kind: u32,
    pub capability: u32,
    pub mode: u32,
    /// Seconds a frame as a fraction.
    pub numerator: u32,
    pub denominator: u32,
    pub extended_mode: u32,
    pub read_buffers: u32,
    pub rest: [[u32; 22]; 2],
}

impl StreamParameters {
    pub const TIME_PER_FRAME: u32 = 0x1000;
}

/// `v4l2_requestbuffers`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct RequestBuffers {
    pub count: u32,
    pub kind: u32,
    pub memory: u32,
    pub capabilities: u32,
    pub flags: u32,
}

/// `v4l2_buffer`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct Buffer<G = Gap> {
    pub index: u32,
    pub kind: u32,
    pub bytes_used: u32,
    pub flags: u32,
    pub field: u32,
    pub padding: u32,
    pub seconds: i64,
    pub microseconds: i64,
    pub timecode: [u32; 4],
    pub sequence: u32,
    pub memory: u32,
    /// Where to map it, with [`MMAP`].
    pub offset: u32,
    pub offset_padding: G,
    pub length: u32,
    pub reserved: [u32; 2],
}

impl Buffer {
    pub const ERROR: u32 = 0x40;
    pub const TIMESTAMP_MASK: u32 = 0xe000;
    pub const TIMESTAMP_MONOTONIC: u32 = 0x2000;

    /// Common first fields of all requests about buffers.
    pub fn mapped(index: u32) -> Self {
        Self { index, kind: CAPTURE, memory: MMAP, ..Self::default() }
    }
}

/// `v4l2_query_ext_ctrl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ControlQuery {
    pub id: u32,
    pub kind: u32,
    pub name: [u8; 32],
    pub minimum: i64,
    pub maximum: i64,
    pub step: u64,
    pub default: i64,
    pub flags: u32,
    pub element_size: u32,
    pub elements: u32,
    pub dimensions: u32,
    pub sizes: [u32; 4],
    pub reserved: [u32; 32],
}

impl ControlQuery {
    /// `V4L2_CTRL_FLAG_NEXT_CTRL`: asks for the control after `id`.
    pub const NEXT: u32 = 0x8000_0000;
    pub const DISABLED: u32 = 0x1;
    pub const READ_ONLY: u32 = 0x4;
}

/// `v4l2_ext_control`, which is packed: its value begins at byte 12.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub struct ControlValue {
    pub id: u32,
    pub size: u32,
    pub reserved: u32,
    /// An `i64`, or an `i32` in the first four bytes.
    pub value: [u8; 8],
}

/// `v4l2_ext_controls`.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct ControlValues<P = *mut ControlValue> {
    pub which: u32,
    pub count: u32,
    pub error_index: u32,
    pub request: i32,
    pub reserved: u32,
    pub controls: P,
}

impl ControlValues {
    /// A request about one control.
    pub fn one(controls: *mut ControlValue) -> Self {
        Self { which: 0, count: 1, error_index: 0, request: 0, reserved: 0, controls }
    }
}

const GROUP: u8 = b'V';

pub const QUERYCAP: Opcode = opcode::read::<Capability>(GROUP, 0);
pub const ENUM_FMT: Opcode = opcode::read_write::<FormatDescription>(GROUP, 2);
pub const S_FMT: Opcode = opcode::read_write::<Format>(GROUP, 5);
pub const REQBUFS: Opcode = opcode::read_write::<RequestBuffers>(GROUP, 8);
pub const QUERYBUF: Opcode = opcode::read_write::<Buffer>(GROUP, 9);
pub const QBUF: Opcode = opcode::read_write::<Buffer>(GROUP, 15);
pub const DQBUF: Opcode = opcode::read_write::<Buffer>(GROUP, 17);
pub const STREAMON: Opcode = opcode::write::<u32>(GROUP, 18);
pub const STREAMOFF: Opcode = opcode::write::<u32>(GROUP, 19);
pub const G_PARM: Opcode = opcode::read_write::<StreamParameters>(GROUP, 21);
pub const S_PARM: Opcode = opcode::read_write::<StreamParameters>(GROUP, 22);
pub const G_EXT_CTRLS: Opcode = opcode::read_write::<ControlValues>(GROUP, 71);
pub const S_EXT_CTRLS: Opcode = opcode::read_write::<ControlValues>(GROUP, 72);
pub const QUERY_EXT_CTRL: Opcode = opcode::read_write::<ControlQuery>(GROUP, 103);

// A number holds direction, size of the structure, group and number of the request; these are what a C compiler makes
// of the header.
const _: () = {
    assert!(QUERYCAP == 0x8068_5600);
    assert!(ENUM_FMT == 0xc040_5602);
    assert!(REQBUFS == 0xc014_5608);
    assert!(STREAMON == 0x4004_5612);
    assert!(STREAMOFF == 0x4004_5613);
    assert!(G_PARM == 0xc0cc_5615);
    assert!(S_PARM == 0xc0cc_5616);
    assert!(QUERY_EXT_CTRL == 0xc0e8_5667);
    assert!(size_of::<ControlValue>() == 20);
};

// For x86-64 and AArch64.
#[cfg(target_pointer_width = "64")]
const _: () = {
    assert!(S_FMT == 0xc0d0_5605);
    assert!(QUERYBUF == 0xc058_5609);
    assert!(QBUF == 0xc058_560f);
    assert!(DQBUF == 0xc058_5611);
    assert!(G_EXT_CTRLS == 0xc020_5647);
    assert!(S_EXT_CTRLS == 0xc020_5648);
};

// For 32-bit ARM, with times of 64 bits.
#[cfg(all(target_pointer_width = "32", target_arch = "arm"))]
const _: () = {
    assert!(S_FMT == 0xc0cc_5605);
    assert!(QUERYBUF == 0xc050_5609);
    assert!(QBUF == 0xc050_560f);
    assert!(DQBUF == 0xc050_5611);
    assert!(G_EXT_CTRLS == 0xc018_5647);
    assert!(S_EXT_CTRLS == 0xc018_5648);
};

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::offset_of;

    /// A field of size 0.
    type NoGap = [u32; 0];

    /// Of both systems, on either: an `i64` is aligned to eight bytes on ARM as on 64-bit systems.
    #[test]
    fn layouts_of_both_widths() {
        assert_eq!((size_of::<Format<u32>>(), size_of::<Format<NoGap>>()), (208, 204));
        assert_eq!((offset_of!(Format<u32>, width), offset_of!(Format<NoGap>, width)), (8, 4));
        assert_eq!((size_of::<Buffer<u32>>(), size_of::<Buffer<NoGap>>()), (88, 80));
        for seconds in [offset_of!(Buffer<u32>, seconds), offset_of!(Buffer<NoGap>, seconds)] {
            assert_eq!(seconds, 24);
        }
        assert_eq!((offset_of!(Buffer<u32>, offset), offset_of!(Buffer<NoGap>, offset)), (64, 64));
        assert_eq!((offset_of!(Buffer<u32>, length), offset_of!(Buffer<NoGap>, length)), (72, 68));
        type Values<P> = ControlValues<P>;
        assert_eq!((size_of::<Values<u64>>(), size_of::<Values<u32>>()), (32, 24));
        assert_eq!(
            (offset_of!(Values<u64>, controls), offset_of!(Values<u32>, controls)),
            (24, 20)
        );
        assert_eq!((size_of::<ControlQuery>(), offset_of!(ControlQuery, minimum)), (232, 40));
        assert_eq!(size_of::<StreamParameters>(), 204);
    }
}
