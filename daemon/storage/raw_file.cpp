// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/raw_file.hpp"

#include <sqlite3.h>

#include <cstdlib>
#include <new>

#include "daemon/storage/sqlite.hpp"

namespace slamgw {

void RawFile::Close::operator()(sqlite3_file* file) const {
  if (file->pMethods) file->pMethods->xClose(file);
  std::free(file);
}

RawFile::RawFile(const std::string& path, Kind kind) {
  sqlite3_vfs* const vfs = sqlite3_vfs_find(nullptr);
  int is_there = 0;
  if (vfs->xAccess(vfs, path.c_str(), SQLITE_ACCESS_EXISTS, &is_there) != SQLITE_OK) {
    throw SqliteError(SQLITE_IOERR, "its directory cannot be read");
  }
  if (!is_there) return;
  // Of the size that the layer wants, which is not sqlite3_file's.
  file_.reset(static_cast<sqlite3_file*>(std::calloc(1, static_cast<std::size_t>(vfs->szOsFile))));
  if (!file_) throw std::bad_alloc();
  const int type = kind == Kind::database ? SQLITE_OPEN_MAIN_DB : SQLITE_OPEN_WAL;
  const std::unique_ptr<char, decltype(&sqlite3_free_filename)> name(
      const_cast<char*>(sqlite3_create_filename(path.c_str(), "", "", 0, nullptr)),
      sqlite3_free_filename);
  int flags = 0;
  int result = vfs->xOpen(vfs, name.get(), file_.get(), SQLITE_OPEN_READONLY | type, &flags);
  sqlite3_int64 size = 0;
  if (result == SQLITE_OK) result = file_->pMethods->xFileSize(file_.get(), &size);
  if (result != SQLITE_OK) throw SqliteError(result & 0xff, sqlite3_errstr(result));
  size_ = static_cast<std::uint64_t>(size);
}

bool RawFile::read(std::uint64_t offset, std::size_t count, Bytes& into) const {
  into.assign(count, 0);
  if (offset >= size_) return true;
  const int result = file_->pMethods->xRead(file_.get(), into.data(), static_cast<int>(count),
                                            static_cast<sqlite3_int64>(offset));
  return result == SQLITE_OK || result == SQLITE_IOERR_SHORT_READ;
}

}  // namespace slamgw
