// A Video4Linux driver in user space, for tests. Preloaded (LD_PRELOAD), it turns two character devices that nobody else
// opens, /dev/zero and /dev/full, into cameras that expose together, at multiples of the interval on the monotonic clock.
// It is written against the kernel's own header, so that structures and request numbers are checked too.
//
//   VIRTUAL_CAMERA_SIZE    1280x480
//   VIRTUAL_CAMERA_0, _1   file with one grey image of that size, which the camera shows
//   VIRTUAL_CAMERA_FAULTS  "unplug" fails frame 12 of the first camera and forgets the device, once;
//                          "damage" marks frame 5 of every camera, and frames 8 and 9 are never delivered
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define BUFFERS 4
#define GAP 64  // bytes between the rows

static struct camera {
    const char *path, *image;
    int fd, streaming, queued[BUFFERS];
    unsigned count, sequence;
    unsigned char *memory[BUFFERS];
    int64_t interval_ns, first_ns;
} cameras[2] = {{.path = "/dev/zero", .image = "VIRTUAL_CAMERA_0", .fd = -1},
                {.path = "/dev/full", .image = "VIRTUAL_CAMERA_1", .fd = -1}};
static int unplugged;

static void *next_in_line(const char *name) { return dlsym(RTLD_NEXT, name); }

static struct camera *camera_of(int fd) {
    for (int i = 0; i < 2; i++)
        if (fd >= 0 && cameras[i].fd == fd) return &cameras[i];
    return NULL;
}

static int has_fault(const char *name) {
    const char *faults = getenv("VIRTUAL_CAMERA_FAULTS");
    return faults && strstr(faults, name);
}

static void size(unsigned *width, unsigned *height) {
    const char *text = getenv("VIRTUAL_CAMERA_SIZE");
    if (!text || sscanf(text, "%ux%u", width, height) != 2) abort();
}

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static int64_t due_ns(const struct camera *c) { return c->first_ns + c->sequence * c->interval_ns; }

static int opened(int fd, const char *path) {
    for (int i = 0; i < 2; i++)
        if (fd >= 0 && !strcmp(path, cameras[i].path)) {
            cameras[i].fd = fd;
            cameras[i].streaming = cameras[i].sequence = cameras[i].count = 0;
        }
    return fd;
}

int open(const char *path, int flags, ...) {
    va_list list;
    va_start(list, flags);
    int mode = va_arg(list, int);
    va_end(list);
    int (*real)(const char *, int, ...) = next_in_line("open");
    return opened(real(path, flags, mode), path);
}

int close(int fd) {
    struct camera *c = camera_of(fd);
    if (c) c->fd = -1;
    int (*real)(int) = next_in_line("close");
    return real(fd);
}

static int set_format(struct v4l2_format *format) {
    size(&format->fmt.pix.width, &format->fmt.pix.height);
    format->fmt.pix.pixelformat = V4L2_PIX_FMT_GREY;
    format->fmt.pix.bytesperline = format->fmt.pix.width + GAP;
    format->fmt.pix.sizeimage = format->fmt.pix.bytesperline * format->fmt.pix.height;
    return 0;
}

static void expose(struct camera *c, unsigned char *out) {
    unsigned width, height;
    size(&width, &height);
    FILE *file = fopen(getenv(c->image), "rb");
    if (!file) abort();
    for (unsigned row = 0; row < height; row++)
        if (fread(out + row * (width + GAP), 1, width, file) != width) abort();
    fclose(file);
}

static int take(struct camera *c, struct v4l2_buffer *buffer) {
    unsigned width, height, index = 0;
    size(&width, &height);
    if (has_fault("unplug") && c == &cameras[0] && c->sequence == 12 && !unplugged) {
        unplugged = 1;
        errno = ENODEV;
        return -1;
    }
    if (has_fault("damage") && c->sequence == 8) c->sequence += 2;
    while (index < c->count && !c->queued[index]) index++;
    if (now_ns() < due_ns(c) || index == c->count) {
        errno = EAGAIN;
        return -1;
    }
    expose(c, c->memory[index]);
    c->queued[index] = 0;
    buffer->index = index;
    buffer->bytesused = (width + GAP) * height;
    buffer->flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    if (has_fault("damage") && c->sequence == 5) buffer->flags |= V4L2_BUF_FLAG_ERROR;
    buffer->timestamp.tv_sec = due_ns(c) / 1000000000;
    buffer->timestamp.tv_usec = due_ns(c) % 1000000000 / 1000;
    buffer->sequence = c->sequence++;
    return 0;
}

static int start(struct camera *c) {
    c->streaming = 1;
    c->first_ns = (now_ns() / c->interval_ns + 1) * c->interval_ns;
    return 0;
}

static int request(struct camera *c, unsigned long number, void *argument) {
    struct v4l2_buffer *buffer = argument;
    switch (number) {
        case VIDIOC_QUERYCAP: {
            struct v4l2_capability *capability = argument;
            memset(capability, 0, sizeof *capability);
            strcpy((char *)capability->card, "Kamera f\xfc" "r alle");  // drivers' names are not always UTF-8
            capability->capabilities = V4L2_CAP_DEVICE_CAPS | V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
            capability->device_caps = V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
            return 0;
        }
        case VIDIOC_ENUM_FMT: {
            struct v4l2_fmtdesc *format = argument;
            format->pixelformat = V4L2_PIX_FMT_GREY;
            errno = EINVAL;
            return format->index == 0 ? 0 : -1;
        }
        case VIDIOC_S_FMT: return set_format(argument);
        case VIDIOC_S_PARM: {
            struct v4l2_fract interval = ((struct v4l2_streamparm *)argument)->parm.capture.timeperframe;
            c->interval_ns = 1000000000LL * interval.numerator / interval.denominator;
            return 0;
        }
        case VIDIOC_REQBUFS: c->count = ((struct v4l2_requestbuffers *)argument)->count = BUFFERS; return 0;
        case VIDIOC_QUERYBUF: {
            struct v4l2_format format;
            set_format(&format);
            buffer->length = format.fmt.pix.sizeimage;
            buffer->m.offset = buffer->index * 4096;
            return 0;
        }
        case VIDIOC_QBUF: c->queued[buffer->index] = 1; return 0;
        case VIDIOC_DQBUF: return take(c, buffer);
        case VIDIOC_STREAMON: return start(c);
        case VIDIOC_STREAMOFF: c->streaming = 0; return 0;
        default: errno = ENOTTY; return -1;
    }
}

long syscall(long number, ...) {
    long a[6];
    va_list list;
    va_start(list, number);
    for (int i = 0; i < 6; i++) a[i] = va_arg(list, long);
    va_end(list);
    struct camera *c = number == SYS_ioctl ? camera_of((int)a[0]) : NULL;
    if (c) return request(c, (unsigned long)a[1], (void *)a[2]);
    long (*real)(long, ...) = next_in_line("syscall");
    return real(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}

void *mmap(void *at, size_t length, int protection, int flags, int fd, off_t offset) {
    void *(*real)(void *, size_t, int, int, int, off_t) = next_in_line("mmap");
    struct camera *c = camera_of(fd);
    if (!c) return real(at, length, protection, flags, fd, offset);
    unsigned index = offset / 4096;
    if (index >= BUFFERS || protection != PROT_READ || flags != MAP_SHARED) abort();
    return c->memory[index] = real(at, length, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
}

int poll(struct pollfd *polled, nfds_t count, int timeout) {
    struct camera *c = count == 1 ? camera_of(polled->fd) : NULL;
    if (!c) {
        int (*real)(struct pollfd *, nfds_t, int) = next_in_line("poll");
        return real(polled, count, timeout);
    }
    int64_t wait_ns = due_ns(c) - now_ns(), most_ns = timeout * 1000000LL;
    int is_due = wait_ns <= most_ns;
    if (!is_due) wait_ns = most_ns;
    if (wait_ns > 0) {
        struct timespec wait = {wait_ns / 1000000000, wait_ns % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, 0, &wait, NULL);
    }
    polled->revents = is_due ? POLLIN : 0;
    return is_due;
}
