// Stands before libc's clock and fsync in one process, by LD_PRELOAD: a wall clock that is set, a disk that is slow.
// FAULTS_OF_TEST names a file of two 64-bit numbers, seconds that the wall clock is ahead and milliseconds that an fsync
// takes, which the test changes while the process runs.
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static volatile const long long *faults;

__attribute__((constructor)) static void map(void) {
  const char *path = getenv("FAULTS_OF_TEST");
  int file = path ? open(path, O_RDONLY) : -1;
  void *bytes = file < 0 ? MAP_FAILED : mmap(NULL, 16, PROT_READ, MAP_SHARED, file, 0);
  if (bytes != MAP_FAILED) faults = bytes;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  int failed = (int)syscall(SYS_clock_gettime, clock, now);
  if (!failed && clock == CLOCK_REALTIME && faults) now->tv_sec += faults[0];
  return failed;
}

int fsync(int file) {
  if (faults && faults[1]) usleep((useconds_t)faults[1] * 1000);
  return (int)syscall(SYS_fsync, file);
}
