// SPDX-License-Identifier: Apache-2.0
// An append log of records with keys on disk: the last record of a key counts. There are numbered
// segments in a directory, and beside each a list of the records that were erased. Each record has
// a checksum, so damage costs only what it hit, and a segment whose records are all erased is
// removed. Blocks; used on the disk's thread.
//
//   <number>-<log id>.log          header, then records, one behind the other
//   <number>-<log id>.log.erased   offset and checksum of each erased record
//   tally                          newest segment, its records, records not erased in all; locked
//
// All numbers are little-endian, checksums CRC-32 (ISO-HDLC). A checksum also covers the log's
// random id, so that no content of a record can pass for a record. Each segment's header has the
// number of records in the segment before, and the tally that of the newest: so a lost end is
// noticed.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/bytes.hpp"

namespace slamgw {

/// The disk did not do what was asked; what() names the file and the reason.
class LogError : public std::runtime_error {
 public:
  /// `error`: an errno.
  LogError(const std::string& what, int error);
  /// The disk failed, perhaps for a moment only.
  bool is_io_error() const { return is_io_error_; }

 private:
  bool is_io_error_;
};

/// Owns a file descriptor.
class OwnedFile {
 public:
  explicit OwnedFile(int descriptor = -1) : descriptor_(descriptor) {}
  ~OwnedFile();
  OwnedFile(OwnedFile&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}
  OwnedFile& operator=(OwnedFile&& other) noexcept {
    std::swap(descriptor_, other.descriptor_);
    return *this;
  }
  int get() const { return descriptor_; }

 private:
  int descriptor_;
};

class RecordLog {
 public:
  /// What open() has found missing. Where a list of erased records is damaged as well, it is not
  /// certain how many of the missing records were still needed.
  struct Summary {
    std::size_t lost_at_least = 0;
    std::size_t lost_at_most = 0;
    std::string where;       ///< the first damaged file
    std::size_t strays = 0;  ///< segments of other logs, which are left alone
  };

  /// Makes the directory (0700), and locks the log; waits up to 3 s for an earlier process. Throws
  /// LogError.
  RecordLog(std::string directory, std::uint32_t segment_bytes);

  /// Reads everything. Call once, before the other members. `skips_unreadable`: what the disk
  /// cannot read is lost; else LogError is thrown for it. Throws LogError also for a log of a newer
  /// version.
  Summary open(bool skips_unreadable);

  /// For the next commit. `content` is not empty.
  void put(std::uint64_t key, Bytes content) { puts_.emplace_back(key, std::move(content)); }
  void erase(std::uint64_t key) { erasures_.push_back(key); }
  /// Writes what was put, and then erases: all of it, or nothing, when it throws LogError.
  /// `is_durable`: it survives a power cut, else the end of the process only. An erasure that the
  /// disk does not take is written with a later one; until then a new process finds the record
  /// again.
  void commit(bool is_durable);

  /// Nothing when there is none, or it is damaged. Throws LogError when the disk fails.
  std::optional<Bytes> read(std::uint64_t key) const;
  bool has(std::uint64_t key) const { return find(key) != nullptr; }
  /// The size of its content; 0: there is none.
  std::uint32_t bytes_of(std::uint64_t key) const;
  /// The first key above `after`.
  std::optional<std::uint64_t> next(std::uint64_t after) const;
  /// At least the highest there has been.
  std::uint64_t last_key() const { return last_key_; }

  /// Writes segments that somebody moved, removed or replaced while they were open to their places
  /// again. Returns the names of those files. Throws LogError.
  std::vector<std::string> put_back_in_place();
  bool is_in_place() const;

  /// Makes durable what was written without that. Throws LogError.
  void synchronise();

 private:
  struct Segment {
    OwnedFile file;
    std::uint32_t bytes = 0;
    std::uint32_t records = 0;           ///< ever written
    std::uint32_t live = 0;              ///< not erased: entries of the index
    std::vector<std::uint32_t> unsaved;  ///< entries of the list of erased records
  };
  /// Where the record of a key is.
  struct Entry {
    std::uint64_t key = 0;
    std::uint32_t segment = 0;
    std::uint32_t offset = 0;  ///< 0: it is erased
    std::uint32_t bytes = 0;   ///< of the content
  };
  using Changes = std::vector<std::pair<std::uint64_t, Bytes>>;
  struct Tally {
    std::uint32_t segment = 0;
    std::uint32_t records = 0;
    std::uint64_t live = 0;
  };
  struct Header;
  struct Scan;
  using Segments = std::map<std::uint32_t, Segment>;  // by number

  void make_directory() const;
  void lock();
  std::map<std::uint32_t, std::string> find_segments();
  std::map<std::uint32_t, std::string> put_under_their_numbers(
      const std::map<std::uint32_t, std::string>& named) const;
  Scan scan(std::uint32_t number, bool skips_unreadable);
  void note_missing(std::uint32_t number, const Scan& scan, Segment& segment,
                    Summary& summary) const;
  void note_missing_segments(std::uint64_t found, Summary& summary) const;
  std::uint64_t size() const { return entries_.size() - erased_; }
  const Entry* find(std::uint64_t key) const;
  Entry* find(std::uint64_t key) { return const_cast<Entry*>(std::as_const(*this).find(key)); }
  void set(const Entry& entry);
  void mark_erased(const Entry& entry);
  std::optional<Bytes> read(const Entry& entry) const;
  Segment& newest() { return segments_.rbegin()->second; }
  void create_segment(std::uint32_t number);
  void append(const Changes& puts, bool is_durable);
  /// The segment with the most erased records, when there are too many of them on disk.
  std::optional<std::uint32_t> sparse_segment() const;
  void move_records_of(std::uint32_t segment, bool is_durable);
  void save_all_erased(bool is_durable);
  void save_erased(std::uint32_t number, Segment& segment, bool is_durable);
  void remove_dead_segments();
  bool write_tally();
  std::optional<Tally> read_tally();
  std::uint64_t bytes() const;
  std::string path_of(std::uint32_t number) const;
  std::uint32_t checksum_of(std::uint32_t segment, const Header& header) const;
  std::uint32_t checksum(std::initializer_list<std::uint32_t> numbers, ByteView octets = {}) const;
  [[noreturn]] void fail(const std::string& path) const;

  const std::string directory_;
  const std::uint32_t segment_bytes_;
  std::uint64_t id_ = 0;
  std::size_t strays_ = 0;
  OwnedFile tally_file_;
  std::optional<Tally> tally_;
  Segments segments_;
  std::deque<Entry> entries_;  // keys rise
  std::size_t erased_ = 0;     // of entries_
  std::uint64_t last_key_ = 0;
  Changes puts_;
  std::vector<std::uint64_t> erasures_;
  std::set<std::uint32_t> unsynchronised_;  // segments that are written, not yet durable
  bool needs_segment_ = true;               // the next record begins one
  std::uint32_t next_segment_ = 1;          // its number
};

}  // namespace slamgw
