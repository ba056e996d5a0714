/* Shifts the wall clock of a process by the nanoseconds in the file that KINCAL_CLOCK names, which the test writes while the process runs.
 * The monotonic clock stays: no machine turns that. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile int64_t *shift_ns;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("KINCAL_CLOCK");
    int fd = path ? open(path, O_RDONLY) : -1;
    if (fd < 0) abort();
    void *map = mmap(NULL, sizeof *shift_ns, PROT_READ, MAP_SHARED, fd, 0);
    if (map == MAP_FAILED) abort();
    shift_ns = map;
}

int clock_gettime(clockid_t id, struct timespec *out) {
    int done = (int)syscall(SYS_clock_gettime, id, out);
    if (done == 0 && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE) && shift_ns) {
        int64_t ns = (int64_t)out->tv_sec * 1000000000 + out->tv_nsec + *shift_ns;
        out->tv_sec = ns / 1000000000;
        out->tv_nsec = ns % 1000000000;
    }
    return done;
}

int gettimeofday(struct timeval *restrict out, void *restrict zone) {
    (void)zone;
    struct timespec now;
    int done = clock_gettime(CLOCK_REALTIME, &now);
    out->tv_sec = now.tv_sec;
    out->tv_usec = now.tv_nsec / 1000;
    return done;
}

time_t time(time_t *out) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (out) *out = now.tv_sec;
    return now.tv_sec;
}
