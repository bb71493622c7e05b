// A library for LD_PRELOAD that makes one system call that writes, or one allocation, fail.
//
// The calls that change regular files or folders are counted over all threads of the process. Environment:
//   FAULT_LOG         file that gets one line per counted call: its name, and whether it was made to fail
//   FAULT_AT          number of the call that fails, from 1 on; without it, calls are only counted
//   FAULT_KIND        kill: the process is killed before the call
//                     torn: a write stores half of its bytes, then the process is killed
//                     short: a write stores half of its bytes and reports so, as a signal or a quota can do
//                     else the number of an error (errno)
//   FAULT_LAST        number of the last call that fails; FAULT_AT by default
//   FAULT_SEED        if set, a call between both fails with a probability of 1/2
//   FAULT_ALLOCATION  number of the allocation that fails, from 1 on
//
// Not seen: calls that a program makes without the C library.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum kind { NONE, KILL, TORN, SHORT, ERROR };

static atomic_ulong calls, allocations;
static unsigned long first, last, seed, failing_allocation;
static int with_seed, error_number, log_file = -1;
static enum kind kind = NONE;

static unsigned long number(const char *name, unsigned long missing) {
    const char *text = getenv(name);
    return text ? strtoul(text, NULL, 10) : missing;
}

__attribute__((constructor)) static void begin(void) {
    const char *text = getenv("FAULT_KIND"), *path = getenv("FAULT_LOG");
    first = number("FAULT_AT", 0);
    last = number("FAULT_LAST", first);
    with_seed = getenv("FAULT_SEED") != NULL;
    seed = number("FAULT_SEED", 0);
    if (text) {
        kind = !strcmp(text, "kill") ? KILL : !strcmp(text, "torn") ? TORN : !strcmp(text, "short") ? SHORT : ERROR;
        error_number = atoi(text);
    }
    if (path)
        log_file = syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    // Last, because the constructors before this one allocate, too.
    failing_allocation = number("FAULT_ALLOCATION", 0);
    if (failing_allocation)
        failing_allocation += atomic_load(&allocations);
}

static void end_process(void) {
    kill(getpid(), SIGKILL);
    for (;;)
        pause();
}

// Counts a call and returns what is to happen to it.
static enum kind fault(const char *name, int is_write) {
    unsigned long at = atomic_fetch_add(&calls, 1) + 1;
    enum kind what = first && at >= first && at <= last ? kind : NONE;
    if (what != NONE && with_seed) {
        // A hash of the number and the seed (splitmix64), so that a case can be repeated.
        uint64_t hash = (at + seed) * 0x9e3779b97f4a7c15u;
        hash = (hash ^ (hash >> 30)) * 0xbf58476d1ce4e5b9u;
        hash = (hash ^ (hash >> 27)) * 0x94d049bb133111ebu;
        if ((hash ^ (hash >> 31)) & 1)
            what = NONE;
    }
    if (!is_write && (what == TORN || what == SHORT))
        what = what == TORN ? KILL : NONE;
    if (log_file >= 0) {
        char line[64];
        int length = snprintf(line, sizeof line, "%s%s\n", name, what == NONE ? "" : " failed");
        syscall(SYS_write, log_file, line, (size_t)length);
    }
    if (what == KILL)
        end_process();
    return what;
}

// Standard output and errors, pipes, sockets and devices are not counted.
static int is_regular(int file) {
    struct stat known;
    return file > 2 && fstat(file, &known) == 0 && S_ISREG(known.st_mode);
}

#define REAL(name) \
    static __typeof__(&name) real; \
    if (!real) \
        real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

// A call that is replaced: its type, name, parameters, arguments, and whether it counts.
#define CALL(type, name, parameters, arguments, counts) \
    type name parameters { \
        REAL(name); \
        if ((counts) && fault(#name, 0) == ERROR) { \
            errno = error_number; \
            return -1; \
        } \
        return real arguments; \
    }

#define OPEN(name, parameters, arguments) \
    int name parameters { \
        REAL(name); \
        mode_t mode = 0; \
        if (flags & (O_CREAT | __O_TMPFILE)) { \
            va_list rest; \
            va_start(rest, flags); \
            mode = va_arg(rest, mode_t); \
            va_end(rest); \
        } \
        if ((flags & (O_WRONLY | O_RDWR | O_CREAT)) && strncmp(path, "/dev/", 5) \
            && fault(#name, 0) == ERROR) { \
            errno = error_number; \
            return -1; \
        } \
        return real arguments; \
    }

OPEN(open, (const char *path, int flags, ...), (path, flags, mode))
OPEN(open64, (const char *path, int flags, ...), (path, flags, mode))
OPEN(openat, (int folder, const char *path, int flags, ...), (folder, path, flags, mode))
OPEN(openat64, (int folder, const char *path, int flags, ...), (folder, path, flags, mode))

CALL(int, fsync, (int file), (file), 1)
CALL(int, fdatasync, (int file), (file), 1)
CALL(int, ftruncate, (int file, off_t length), (file, length), 1)
CALL(int, ftruncate64, (int file, off64_t length), (file, length), 1)
CALL(int, fchmod, (int file, mode_t mode), (file, mode), 1)
CALL(int, chmod, (const char *path, mode_t mode), (path, mode), 1)
CALL(int, chown, (const char *path, uid_t user, gid_t group), (path, user, group), 1)
CALL(int, rename, (const char *from, const char *to), (from, to), 1)
CALL(int, renameat, (int a, const char *from, int b, const char *to), (a, from, b, to), 1)
CALL(int, renameat2, (int a, const char *from, int b, const char *to, unsigned int flags),
     (a, from, b, to, flags), 1)
CALL(int, link, (const char *from, const char *to), (from, to), 1)
CALL(int, linkat, (int a, const char *from, int b, const char *to, int flags), (a, from, b, to, flags), 1)
CALL(int, symlink, (const char *from, const char *to), (from, to), 1)
CALL(int, mkdir, (const char *path, mode_t mode), (path, mode), 1)
CALL(int, mkdirat, (int folder, const char *path, mode_t mode), (folder, path, mode), 1)
CALL(int, rmdir, (const char *path), (path), 1)
CALL(int, unlink, (const char *path), (path), 1)
CALL(int, unlinkat, (int folder, const char *path, int flags), (folder, path, flags), 1)
CALL(ssize_t, copy_file_range, (int from, off64_t *a, int to, off64_t *b, size_t size, unsigned int flags),
     (from, a, to, b, size, flags), 1)

ssize_t write(int file, const void *bytes, size_t size) {
    REAL(write);
    enum kind what = is_regular(file) ? fault("write", 1) : NONE;
    if (what == ERROR) {
        errno = error_number;
        return -1;
    }
    // A write of no bytes would be reported as an error by the caller.
    if (what == SHORT || what == TORN)
        size = (size + 1) / 2;
    ssize_t written = real(file, bytes, size);
    if (what == TORN)
        end_process();
    return written;
}

ssize_t writev(int file, const struct iovec *parts, int count) {
    REAL(writev);
    enum kind what = is_regular(file) ? fault("writev", 1) : NONE;
    if (what == ERROR) {
        errno = error_number;
        return -1;
    }
    ssize_t written = real(file, parts, (what == SHORT || what == TORN) && count > 1 ? count / 2 : count);
    if (what == TORN)
        end_process();
    return written;
}

#ifdef __GLIBC__
extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void *, size_t);
extern void *__libc_memalign(size_t, size_t);

static int allocation_fails(void) {
    unsigned long at = atomic_fetch_add(&allocations, 1) + 1;
    if (!failing_allocation || at != failing_allocation)
        return 0;
    if (log_file >= 0)
        syscall(SYS_write, log_file, "allocation failed\n", (size_t)18);
    errno = ENOMEM;
    return 1;
}

void *malloc(size_t size) { return allocation_fails() ? NULL : __libc_malloc(size); }
void *calloc(size_t count, size_t size) { return allocation_fails() ? NULL : __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { return allocation_fails() ? NULL : __libc_realloc(old, size); }

int posix_memalign(void **place, size_t alignment, size_t size) {
    if (allocation_fails())
        return ENOMEM;
    *place = __libc_memalign(alignment, size);
    return *place ? 0 : ENOMEM;
}

__attribute__((destructor)) static void finish(void) {
    char line[64];
    int length = snprintf(line, sizeof line, "%lu allocations\n", atomic_load(&allocations));
    if (log_file >= 0)
        syscall(SYS_write, log_file, line, (size_t)length);
}
#endif
