// SPDX-License-Identifier: Apache-2.0
// Preloaded into the daemon by the soak. Moves its wall clock by the seconds in the file
// MOVED_CLOCK (8 octets). The kernel waits by the real clock, so the ends of waits are moved back.
// The monotonic clock is not changed.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile const int64_t* offset;

__attribute__((constructor)) static void map_offset(void) {
  const char* path = getenv("MOVED_CLOCK");
  const int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
  if (file < 0) return;
  void* page = mmap(NULL, sizeof *offset, PROT_READ, MAP_SHARED, file, 0);
  close(file);
  if (page != MAP_FAILED) offset = page;
}

static int64_t moved_by(void) { return offset ? *offset : 0; }

int clock_gettime(clockid_t clock, struct timespec* time) {
  static int (*real)(clockid_t, struct timespec*);
  if (!real) real = (int (*)(clockid_t, struct timespec*))dlsym(RTLD_NEXT, "clock_gettime");
  const int result = real(clock, time);
  if (result == 0 && clock == CLOCK_REALTIME) time->tv_sec += moved_by();
  return result;
}

int gettimeofday(struct timeval* restrict time, void* restrict zone) {
  static int (*real)(struct timeval*, void*);
  if (!real) real = (int (*)(struct timeval*, void*))dlsym(RTLD_NEXT, "gettimeofday");
  const int result = real(time, zone);
  if (result == 0) time->tv_sec += moved_by();
  return result;
}

time_t time(time_t* out) {
  struct timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  if (out) *out = now.tv_sec;
  return now.tv_sec;
}

int sem_timedwait(sem_t* restrict semaphore, const struct timespec* restrict until) {
  static int (*real)(sem_t*, const struct timespec*);
  if (!real) real = (int (*)(sem_t*, const struct timespec*))dlsym(RTLD_NEXT, "sem_timedwait");
  struct timespec end = *until;
  end.tv_sec -= moved_by();
  return real(semaphore, &end);
}

// Only the daemon's MQTT client waits like this for a time of the wall clock. Times of the
// monotonic clock are years earlier. A step of the clock during the wait counts, as in the kernel.
int pthread_cond_timedwait(pthread_cond_t* restrict condition, pthread_mutex_t* restrict mutex,
                           const struct timespec* restrict until) {
  static int (*real)(pthread_cond_t*, pthread_mutex_t*, const struct timespec*);
  if (!real)
    real = (int (*)(pthread_cond_t*, pthread_mutex_t*, const struct timespec*))dlvsym(
        RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
  const time_t years = 20LL * 365 * 24 * 3600;
  const int64_t second_ns = 1000000000, slice_ns = 20000000;
  if (until->tv_sec < years) return real(condition, mutex, until);
  for (;;) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    int64_t left = (until->tv_sec - now.tv_sec) * second_ns + until->tv_nsec - now.tv_nsec;
    const int is_last = left <= slice_ns;
    left = left < 0 ? 0 : is_last ? left : slice_ns;
    int64_t end = (now.tv_sec - moved_by()) * second_ns + now.tv_nsec + left;
    const struct timespec next = {end / second_ns, end % second_ns};
    const int result = real(condition, mutex, &next);
    if (result != ETIMEDOUT || is_last) return result;
  }
}
