// SPDX-License-Identifier: Apache-2.0
#include "tests/storage/faulty_disk.hpp"

#include <sqlite3.h>
#include <sys/stat.h>

#include <cstdlib>

namespace slamgw::test {
namespace {

sqlite3_vfs* real_vfs = nullptr;

/// What SQLite gets; the real file lies behind it.
struct FaultyFile {
  sqlite3_file base;
  ino_t inode;
};

std::atomic<ino_t> unreadable_inode{0};
std::atomic<std::uint64_t> unreadable_from{0};
std::atomic<std::uint64_t> unreadable_to{0};

ino_t inode_of(const char* path) {
  struct stat status {};
  return path && stat(path, &status) == 0 ? status.st_ino : 0;
}

sqlite3_file* real(sqlite3_file* file) {
  return reinterpret_cast<sqlite3_file*>(reinterpret_cast<FaultyFile*>(file) + 1);
}

bool is_read_failing(sqlite3_file* file, sqlite3_int64 offset, int amount) {
  if (FaultyDisk::fails_reads) return true;
  const ino_t inode = reinterpret_cast<FaultyFile*>(file)->inode;
  if (inode == 0 || inode != unreadable_inode) return false;
  const auto from = static_cast<std::uint64_t>(offset);
  return from < unreadable_to && from + static_cast<std::uint64_t>(amount) > unreadable_from;
}

int read(sqlite3_file* file, void* into, int amount, sqlite3_int64 offset) {
  if (!is_read_failing(file, offset, amount)) {
    return real(file)->pMethods->xRead(real(file), into, amount, offset);
  }
  ++FaultyDisk::failed_reads;
  return SQLITE_IOERR_READ;
}

int write(sqlite3_file* file, const void* from, int amount, sqlite3_int64 offset) {
  if (FaultyDisk::fails_writes) return SQLITE_IOERR_WRITE;
  return real(file)->pMethods->xWrite(real(file), from, amount, offset);
}

int sync(sqlite3_file* file, int flags) {
  if (FaultyDisk::fails_syncs) return SQLITE_IOERR_FSYNC;
  return real(file)->pMethods->xSync(real(file), flags);
}

int close(sqlite3_file* file) { return real(file)->pMethods->xClose(real(file)); }
int truncate(sqlite3_file* file, sqlite3_int64 size) {
  return real(file)->pMethods->xTruncate(real(file), size);
}
int file_size(sqlite3_file* file, sqlite3_int64* size) {
  return real(file)->pMethods->xFileSize(real(file), size);
}
int lock(sqlite3_file* file, int level) { return real(file)->pMethods->xLock(real(file), level); }
int unlock(sqlite3_file* file, int level) {
  return real(file)->pMethods->xUnlock(real(file), level);
}
int check_reserved_lock(sqlite3_file* file, int* result) {
  return real(file)->pMethods->xCheckReservedLock(real(file), result);
}
int file_control(sqlite3_file* file, int what, void* argument) {
  return real(file)->pMethods->xFileControl(real(file), what, argument);
}
int sector_size(sqlite3_file* file) { return real(file)->pMethods->xSectorSize(real(file)); }
int device_characteristics(sqlite3_file* file) {
  return real(file)->pMethods->xDeviceCharacteristics(real(file));
}

/// Version 1 has no shared memory, which an exclusive lock needs none of.
const sqlite3_io_methods methods{1,
                                 close,
                                 read,
                                 write,
                                 truncate,
                                 sync,
                                 file_size,
                                 lock,
                                 unlock,
                                 check_reserved_lock,
                                 file_control,
                                 sector_size,
                                 device_characteristics,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr,
                                 nullptr};

int open(sqlite3_vfs*, sqlite3_filename name, sqlite3_file* file, int flags, int* out_flags) {
  const int result = real_vfs->xOpen(real_vfs, name, real(file), flags, out_flags);
  reinterpret_cast<FaultyFile*>(file)->inode = inode_of(name);
  file->pMethods = real(file)->pMethods ? &methods : nullptr;
  return result;
}

sqlite3_vfs& faulty_vfs() {
  static sqlite3_vfs vfs = [] {
    real_vfs = sqlite3_vfs_find("unix");
    sqlite3_vfs made = *real_vfs;
    made.zName = "faulty";
    made.szOsFile = static_cast<int>(sizeof(FaultyFile)) + real_vfs->szOsFile;
    made.xOpen = open;
    return made;
  }();
  return vfs;
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
  sqlite3_vfs_register(&faulty_vfs(), 1);
}

FaultyDisk::~FaultyDisk() { sqlite3_vfs_unregister(&faulty_vfs()); }

void FaultyDisk::make_unreadable(const std::string& path, std::uint64_t from, std::uint64_t to) {
  unreadable_from = from;
  unreadable_to = to;
  unreadable_inode = inode_of(path.c_str());
}

}  // namespace slamgw::test
