// SPDX-License-Identifier: Apache-2.0
#include "tests/storage/faulty_disk.hpp"

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdarg>

namespace slamgw::test {
namespace {

std::atomic<ino_t> unreadable_inode{0};
std::atomic<std::uint64_t> unreadable_from{0};
std::atomic<std::uint64_t> unreadable_to{0};

bool is_read_failing(int file, std::uint64_t offset, std::uint64_t count) {
  if (FaultyDisk::fails_reads) return true;
  if (unreadable_inode == 0) return false;
  struct stat status {};
  return fstat(file, &status) == 0 && status.st_ino == unreadable_inode && offset < unreadable_to &&
         offset + count > unreadable_from;
}

template <class Call>
Call real(const char* name) {
  return reinterpret_cast<Call>(dlsym(RTLD_NEXT, name));
}

int fail(int error = EIO) {
  errno = error;
  return -1;
}

}  // namespace

std::atomic<bool> FaultyDisk::fails_reads{false};
std::atomic<bool> FaultyDisk::fails_writes{false};
std::atomic<bool> FaultyDisk::fails_syncs{false};
std::atomic<bool> FaultyDisk::is_read_only{false};
std::atomic<std::uint64_t> FaultyDisk::failed_reads{0};

FaultyDisk::FaultyDisk() {
  fails_reads = fails_writes = fails_syncs = is_read_only = false;
  failed_reads = 0;
  unreadable_inode = 0;
}

FaultyDisk::~FaultyDisk() {
  fails_reads = fails_writes = fails_syncs = is_read_only = false;
  unreadable_inode = 0;
}

void FaultyDisk::make_unreadable(const std::string& path, std::uint64_t from, std::uint64_t to) {
  struct stat status {};
  unreadable_from = from;
  unreadable_to = to;
  unreadable_inode = stat(path.c_str(), &status) == 0 ? status.st_ino : 0;
}

}  // namespace slamgw::test

// The program's calls arrive here before they reach the C library.
extern "C" {

int open(const char* path, int flags, ...) {
  using namespace slamgw::test;
  static const auto call = real<int (*)(const char*, int, mode_t)>("open");
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(rest, mode_t) : 0;
  va_end(rest);
  const bool is_for_writing = (flags & O_ACCMODE) != O_RDONLY;
  return FaultyDisk::is_read_only && is_for_writing ? fail(EROFS) : call(path, flags, mode);
}

int unlink(const char* path) {
  using namespace slamgw::test;
  static const auto call = real<int (*)(const char*)>("unlink");
  return FaultyDisk::is_read_only ? fail(EROFS) : call(path);
}

ssize_t pread(int file, void* into, size_t count, off_t offset) {
  using namespace slamgw::test;
  static const auto call = real<ssize_t (*)(int, void*, size_t, off_t)>("pread");
  if (!is_read_failing(file, static_cast<std::uint64_t>(offset), count))
    return call(file, into, count, offset);
  ++FaultyDisk::failed_reads;
  return fail();
}

ssize_t pwrite(int file, const void* from, size_t count, off_t offset) {
  using namespace slamgw::test;
  static const auto call = real<ssize_t (*)(int, const void*, size_t, off_t)>("pwrite");
  return FaultyDisk::fails_writes ? fail() : call(file, from, count, offset);
}

/// Like ext2's, which loses the blocks behind the first twelve when the disk fails.
int ftruncate(int file, off_t size) {
  using namespace slamgw::test;
  static const auto call = real<int (*)(int, off_t)>("ftruncate");
  if (FaultyDisk::fails_syncs && size > 12288) call(file, 12288);
  return call(file, size);
}

int fdatasync(int file) {
  using namespace slamgw::test;
  static const auto call = real<int (*)(int)>("fdatasync");
  return FaultyDisk::fails_syncs ? fail() : call(file);
}

int fsync(int file) {
  using namespace slamgw::test;
  static const auto call = real<int (*)(int)>("fsync");
  return FaultyDisk::fails_syncs ? fail() : call(file);
}

}  // extern "C"
