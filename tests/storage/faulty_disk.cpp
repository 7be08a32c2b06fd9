// SPDX-License-Identifier: Apache-2.0
#include "tests/storage/faulty_disk.hpp"

#include <dlfcn.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

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

int fail() {
  errno = EIO;
  return -1;
}

}  // namespace

std::atomic<bool> FaultyDisk::fails_reads{false};
std::atomic<bool> FaultyDisk::fails_writes{false};
std::atomic<bool> FaultyDisk::fails_syncs{false};
std::atomic<std::uint64_t> FaultyDisk::failed_reads{0};

FaultyDisk::FaultyDisk() {
  fails_reads = fails_writes = fails_syncs = false;
  failed_reads = 0;
  unreadable_inode = 0;
}

FaultyDisk::~FaultyDisk() {
  fails_reads = fails_writes = fails_syncs = false;
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
