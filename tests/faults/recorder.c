/* Records what a process writes to its database and what it syncs, for replay (power.rs). LD_PRELOADed; KINCAL_RECORD names the log.
 * One record: operation (1 write, 2 sync, 3 truncate), file (0 database, 1 write-ahead log), offset, length, time (ns since the epoch), bytes.
 * A lock is held from before the call until its record is written, so that the order of the log is the order of the calls. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static FILE *log_file;

static int file_of(int fd) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0) return -1;
    path[n] = 0;
    const char *name = strrchr(path, '/');
    if (!name) return -1;
    if (!strcmp(name, "/kincal.sqlite")) return 0;
    if (!strcmp(name, "/kincal.sqlite-wal")) return 1;
    return -1;
}

static void record(uint8_t operation, int file, uint64_t offset, uint64_t length, const void *bytes) {
    if (!log_file) {
        const char *path = getenv("KINCAL_RECORD");
        if (!path || !(log_file = fopen(path, "wb"))) abort();
    }
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    uint64_t head[4] = {(uint64_t)operation | (uint64_t)file << 8, offset, length, (uint64_t)now.tv_sec * 1000000000u + (uint64_t)now.tv_nsec};
    fwrite(head, sizeof head, 1, log_file);
    if (bytes) fwrite(bytes, 1, length, log_file);
    fflush(log_file);
}

#define REAL(name, type) static __typeof__(type) *real; if (!real) real = (__typeof__(type) *)dlsym(RTLD_NEXT, name)

ssize_t write(int fd, const void *bytes, size_t n) {
    REAL("write", ssize_t(int, const void *, size_t));
    int file = file_of(fd);
    if (file < 0) return real(fd, bytes, n);
    pthread_mutex_lock(&lock);
    off_t offset = lseek(fd, 0, SEEK_CUR);
    record(1, file, (uint64_t)offset, n, bytes);
    ssize_t done = real(fd, bytes, n);
    pthread_mutex_unlock(&lock);
    return done;
}

ssize_t pwrite64(int fd, const void *bytes, size_t n, off64_t offset) {
    REAL("pwrite64", ssize_t(int, const void *, size_t, off64_t));
    int file = file_of(fd);
    if (file < 0) return real(fd, bytes, n, offset);
    pthread_mutex_lock(&lock);
    record(1, file, (uint64_t)offset, n, bytes);
    ssize_t done = real(fd, bytes, n, offset);
    pthread_mutex_unlock(&lock);
    return done;
}

ssize_t pwrite(int fd, const void *bytes, size_t n, off_t offset) { return pwrite64(fd, bytes, n, offset); }

static int synced(int fd, const char *name) {
    int (*real)(int) = (int (*)(int))dlsym(RTLD_NEXT, name);
    int file = file_of(fd);
    if (file < 0) return real(fd);
    pthread_mutex_lock(&lock);
    int done = real(fd);
    if (done == 0) record(2, file, 0, 0, NULL);
    pthread_mutex_unlock(&lock);
    return done;
}

int fsync(int fd) { return synced(fd, "fsync"); }
int fdatasync(int fd) { return synced(fd, "fdatasync"); }

int ftruncate64(int fd, off64_t length) {
    REAL("ftruncate64", int(int, off64_t));
    int file = file_of(fd);
    if (file < 0) return real(fd, length);
    pthread_mutex_lock(&lock);
    record(3, file, (uint64_t)length, 0, NULL);
    int done = real(fd, length);
    pthread_mutex_unlock(&lock);
    return done;
}

int ftruncate(int fd, off_t length) { return ftruncate64(fd, length); }
