//! Frames of a Video4Linux2 camera, where the driver put them: memory-mapped streaming, no copy.
//!
//! The kernel stamps a frame on the same monotonic clock as [`crate::host_now`]. Formats are never converted: what the
//! driver would deliver instead of what was asked is refused, with what it offers.

use ipc_types::HostTime;
use moq_v4l::sys::{
    V4L2_BUF_FLAG_ERROR, V4L2_BUF_FLAG_TIMESTAMP_MASK, V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC, V4L2_BUF_FLAG_TSTAMP_SRC_EOF,
    V4L2_BUF_FLAG_TSTAMP_SRC_MASK, V4L2_CAP_STREAMING, V4L2_CAP_VIDEO_CAPTURE, v4l2_buffer, v4l2_capability,
    v4l2_fmtdesc, v4l2_format, v4l2_requestbuffers, v4l2_streamparm,
};
use moq_v4l::v4l2::{self, vidioc};
use moq_v4l::{Device, Memory, buffer};
use std::io;
use std::path::Path;
use std::ptr::NonNull;
use std::time::Duration;

/// Buffers between driver and reader: one being filled, one waiting, two read.
const BUFFERS: u32 = 4;

/// What is asked of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VideoFormat {
    /// Width of the whole image, px.
    pub width_px: u32,
    /// Height, px.
    pub height_px: u32,
    /// Format of the pixels, e.g. `*b"YUYV"`.
    pub four_cc: [u8; 4],
    /// Frames per second.
    pub rate_hz: f64,
}

/// A streaming camera.
pub struct VideoQueue {
    device: Device,
    buffers: Vec<Mapping>,
    stride: usize,
}

impl std::fmt::Debug for VideoQueue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VideoQueue")
            .field("buffers", &self.buffers)
            .field("stride", &self.stride)
            .finish_non_exhaustive()
    }
}

/// A driver's buffer in this process.
#[derive(Clone, Copy, Debug)]
struct Mapping {
    start: NonNull<u8>,
    bytes: usize,
}

/// A frame; dropping it gives its buffer back to the driver.
pub struct VideoFrame<'a> {
    queue: &'a VideoQueue,
    buffer: v4l2_buffer,
}

impl std::fmt::Debug for VideoFrame<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "frame {} of {} bytes", self.sequence(), self.bytes().len())
    }
}

/// A zeroed kernel structure.
fn zeroed<T: KernelStruct>() -> T {
    // SAFETY: `KernelStruct` types are plain C structures of integers and unions of them; all zeros is a value of each.
    unsafe { std::mem::zeroed() }
}

/// C structures of the kernel's interface: integers, unions of integers, raw pointers.
///
/// # Safety
/// All zeros must be a valid value.
unsafe trait KernelStruct {}
// SAFETY: see the trait; these are the structures of `videodev2.h`.
unsafe impl KernelStruct for v4l2_buffer {}
// SAFETY: as above.
unsafe impl KernelStruct for v4l2_capability {}
// SAFETY: as above.
unsafe impl KernelStruct for v4l2_fmtdesc {}
// SAFETY: as above.
unsafe impl KernelStruct for v4l2_format {}
// SAFETY: as above.
unsafe impl KernelStruct for v4l2_requestbuffers {}
// SAFETY: as above.
unsafe impl KernelStruct for v4l2_streamparm {}

fn described(index: u32) -> v4l2_buffer {
    v4l2_buffer { index, type_: CAPTURE, memory: Memory::Mmap as u32, ..zeroed() }
}

const CAPTURE: u32 = buffer::Type::VideoCapture as u32;

impl VideoQueue {
    /// Opens a camera and starts it.
    ///
    /// # Errors
    /// No such device, in use, no camera that streams, or it does not offer the format.
    pub fn start(path: &Path, format: VideoFormat) -> io::Result<Self> {
        let mut queue = Self { device: Device::with_path(path)?, buffers: Vec::new(), stride: 0 };
        let mut can: v4l2_capability = zeroed();
        queue.control(vidioc::VIDIOC_QUERYCAP, &mut can).map_err(|_| io::Error::other("is not a camera"))?;
        let needed = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
        if can.device_caps & needed != needed {
            return Err(io::Error::other("is a video device, but not one that captures and streams"));
        }
        queue.stride = queue.set_format(format)?;
        queue.set_rate(format.rate_hz)?;
        let mut request =
            v4l2_requestbuffers { count: BUFFERS, type_: CAPTURE, memory: Memory::Mmap as u32, ..zeroed() };
        queue.control(vidioc::VIDIOC_REQBUFS, &mut request)?;
        for index in 0..request.count {
            let mut buffer = described(index);
            queue.control(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
            queue.map(&buffer)?;
            queue.control(vidioc::VIDIOC_QBUF, &mut described(index))?;
        }
        queue.control(vidioc::VIDIOC_STREAMON, &mut (CAPTURE as i32))?;
        Ok(queue)
    }

    /// Bytes from one row to the next; 0 for a compressed format.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The next frame, or `None` when `patience` is over.
    ///
    /// # Errors
    /// The camera is gone, or its driver in trouble.
    pub fn next(&self, patience: Duration) -> io::Result<Option<VideoFrame<'_>>> {
        let milliseconds = i32::try_from(patience.as_millis()).unwrap_or(i32::MAX);
        match self.device.handle().poll(libc::POLLIN, milliseconds) {
            Ok(0) => return Ok(None),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::Interrupted => return Ok(None),
            Err(error) => return Err(error),
        }
        let mut buffer = described(0);
        match self.control(vidioc::VIDIOC_DQBUF, &mut buffer) {
            Ok(()) => {}
            // Woken without a frame.
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) => return Err(error),
        }
        if buffer.index as usize >= self.buffers.len() {
            return Err(io::Error::other(format!("the driver returned buffer {}, which does not exist", buffer.index)));
        }
        Ok(Some(VideoFrame { queue: self, buffer }))
    }

    /// Sets the format; returns the stride.
    fn set_format(&self, asked: VideoFormat) -> io::Result<usize> {
        let mut format = v4l2_format { type_: CAPTURE, ..zeroed() };
        format.fmt.pix.width = asked.width_px;
        format.fmt.pix.height = asked.height_px;
        format.fmt.pix.pixelformat = u32::from_le_bytes(asked.four_cc);
        self.control(vidioc::VIDIOC_S_FMT, &mut format)?;
        // SAFETY: for this buffer type the driver fills `pix`, and any bytes are valid integers.
        let given = unsafe { format.fmt.pix };
        let four_cc = given.pixelformat.to_le_bytes();
        if (given.width, given.height, four_cc) != (asked.width_px, asked.height_px, asked.four_cc) {
            return Err(io::Error::other(format!(
                "delivers {} x {} px {} where {} x {} px {} was asked; it offers {}",
                given.width,
                given.height,
                name(four_cc),
                asked.width_px,
                asked.height_px,
                name(asked.four_cc),
                self.offers().join(", ")
            )));
        }
        Ok(given.bytesperline as usize)
    }

    /// Names of the pixel formats that the driver offers.
    fn offers(&self) -> Vec<String> {
        let format = |index: u32| {
            let mut format = v4l2_fmtdesc { index, type_: CAPTURE, ..zeroed() };
            self.control(vidioc::VIDIOC_ENUM_FMT, &mut format).ok()?;
            Some(name(format.pixelformat.to_le_bytes()))
        };
        (0..64).map_while(format).collect()
    }

    /// Asks for a rate; cameras that cannot set one keep their own.
    fn set_rate(&self, rate_hz: f64) -> io::Result<()> {
        let mut parameters = v4l2_streamparm { type_: CAPTURE, ..zeroed() };
        parameters.parm.capture.timeperframe.numerator = 1000;
        parameters.parm.capture.timeperframe.denominator = (rate_hz * 1000.0).round() as u32;
        match self.control(vidioc::VIDIOC_S_PARM, &mut parameters) {
            Err(error) if error.raw_os_error() == Some(libc::ENOTTY) || error.raw_os_error() == Some(libc::EINVAL) => {
                Ok(())
            }
            other => other,
        }
    }

    fn map(&mut self, buffer: &v4l2_buffer) -> io::Result<()> {
        let bytes = buffer.length as usize;
        // SAFETY: for this memory type the driver fills `offset`; any bytes are a valid integer.
        let offset = i64::from(unsafe { buffer.m.offset });
        let fd = self.device.handle().fd();
        // SAFETY: a new mapping at an address of the kernel's choice touches nothing of this process; it is unmapped when
        // the queue is dropped, and frames that point into it borrow the queue.
        let start = unsafe { v4l2::mmap(std::ptr::null_mut(), bytes, libc::PROT_READ, libc::MAP_SHARED, fd, offset) }?;
        let start = NonNull::new(start.cast()).ok_or_else(|| io::Error::other("mapped to nowhere"))?;
        self.buffers.push(Mapping { start, bytes });
        Ok(())
    }

    fn control<T>(&self, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        loop {
            // SAFETY: every request is called with the structure that its number encodes (the `vidioc` table), which the
            // kernel reads and writes within its size for the duration of the call.
            let result =
                unsafe { v4l2::ioctl(self.device.handle().fd(), request, std::ptr::from_mut(argument).cast()) };
            match result {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }
}

impl Drop for VideoQueue {
    fn drop(&mut self) {
        // A camera that is gone cannot be stopped, and has stopped.
        let _ = self.control(vidioc::VIDIOC_STREAMOFF, &mut (CAPTURE as i32));
        for Mapping { start, bytes } in self.buffers.drain(..) {
            // SAFETY: mapped by `map` with this length, and no frame borrows the queue any more.
            let _ = unsafe { v4l2::munmap(start.as_ptr().cast(), bytes) };
        }
    }
}

impl VideoFrame<'_> {
    /// The bytes that the driver wrote.
    pub fn bytes(&self) -> &[u8] {
        let Mapping { start, bytes } = self.queue.buffers[self.buffer.index as usize];
        // SAFETY: the mapping is that long and lives as long as the queue, which is borrowed; until the buffer is given
        // back, when this frame is dropped, the driver does not write to it.
        unsafe { std::slice::from_raw_parts(start.as_ptr(), bytes.min(self.buffer.bytesused as usize)) }
    }

    /// When the driver stamped the frame: at the start of the exposure, or at the end of the transfer, as the driver
    /// does; `None` for a driver whose clock is another one.
    pub fn stamped(&self) -> Option<HostTime> {
        let is_monotonic = self.buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
        let at = self.buffer.timestamp;
        is_monotonic.then(|| HostTime::from_nanos(at.tv_sec * 1_000_000_000 + at.tv_usec * 1000))
    }

    /// Whether the stamp is of the frame's end rather than of its exposure.
    pub fn is_stamped_at_end(&self) -> bool {
        self.buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK == V4L2_BUF_FLAG_TSTAMP_SRC_EOF
    }

    /// Whether the driver says that data are missing.
    pub fn is_damaged(&self) -> bool {
        self.buffer.flags & V4L2_BUF_FLAG_ERROR != 0
    }

    /// Counts the camera's frames, also those that nobody took.
    pub fn sequence(&self) -> u32 {
        self.buffer.sequence
    }
}

impl Drop for VideoFrame<'_> {
    fn drop(&mut self) {
        // If the driver refuses it, it has one buffer less; `next` will tell what is wrong with it.
        let _ = self.queue.control(vidioc::VIDIOC_QBUF, &mut described(self.buffer.index));
    }
}

fn name(four_cc: [u8; 4]) -> String {
    String::from_utf8_lossy(&four_cc).trim_end().to_owned()
}
