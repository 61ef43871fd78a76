/* A disk that fails, by LD_PRELOAD: the writes of one process, to files whose path holds BAD_DISK_NAME.
 *
 * The file BAD_DISK holds four numbers of 64 bits: what happens (0 nothing, an errno, or -1: each write is cut short),
 * how many writes still pass, how many were made, how many failed. It is mapped, so that a test can change it meanwhile.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/uio.h>
#include <unistd.h>

static volatile int64_t *state;

__attribute__((constructor)) static void begin(void) {
    const char *name = getenv("BAD_DISK");
    int fd = name ? open(name, O_RDWR) : -1;
    if (fd >= 0) {
        void *map = mmap(NULL, 32, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
        state = map == MAP_FAILED ? NULL : map;
        close(fd);
    }
}

static int concerns(int fd) {
    char link[64], path[4096];
    const char *name = getenv("BAD_DISK_NAME");
    if (!state || !name) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return strstr(path, name) != NULL;
}

#define PAGE 4096

/* Bytes that may be written, or -1: it fails. The write that meets the full disk first is cut at a page, as systems do:
 * within a page it is all or nothing. */
static ssize_t granted(int fd, size_t size, off64_t offset) {
    if (!concerns(fd)) return (ssize_t)size;
    state[2]++;
    if (state[0] == 0) return (ssize_t)size;
    if (state[0] < 0) return size > 1 ? (ssize_t)(size / 2) : (ssize_t)size;
    if (state[1]-- > 0) return (ssize_t)size;
    state[3]++;
    size_t in_page = PAGE - (size_t)(offset % PAGE);
    if (state[0] == ENOSPC && state[1] == -1 && size > in_page) return (ssize_t)in_page;
    errno = (int)state[0];
    return -1;
}

#define REAL(name) __typeof__(&name) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

#define WRITE(name, offset_type)                                               \
    ssize_t name(int fd, const void *data, size_t size, offset_type offset) { \
        REAL(name);                                                            \
        ssize_t n = granted(fd, size, offset);                                 \
        return n < 0 ? -1 : real(fd, data, (size_t)n, offset);                 \
    }
WRITE(pwrite, off_t)
WRITE(pwrite64, off64_t)

ssize_t write(int fd, const void *data, size_t size) {
    REAL(write);
    ssize_t n = granted(fd, size, 0);
    return n < 0 ? -1 : real(fd, data, (size_t)n);
}

#define SIMPLE(name)                          \
    int name(int fd) {                               \
        REAL(name);                                  \
        return granted(fd, 1, 0) < 0 ? -1 : real(fd); \
    }
SIMPLE(fsync)
SIMPLE(fdatasync)

int ftruncate(int fd, off_t length) {
    REAL(ftruncate);
    return granted(fd, 1, 0) < 0 ? -1 : real(fd, length);
}

int ftruncate64(int fd, off64_t length) {
    REAL(ftruncate64);
    return granted(fd, 1, 0) < 0 ? -1 : real(fd, length);
}
