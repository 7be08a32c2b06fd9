// SPDX-License-Identifier: Apache-2.0
// An append log of records with keys on disk: the last record of a key counts. The directory has
// numbered segments, and beside each a list of its erased records. Each record has a checksum, so
// damage loses only the records that it hit. A segment whose records are all erased is removed.
// Blocks; used on the disk's thread.
//
//   <number>-<log id>.log          header, then records, one behind the other
//   <number>-<log id>.log.erased   offset and checksum of each erased record
//   tally                          newest segment, its records, live records in all; locked
//
// All numbers are little-endian, checksums CRC-32 (ISO-HDLC). A checksum also covers the log's
// random id, so that no content of a record can pass for a record. Each segment's header has the
// number of records in the segment before, and the tally has that of the newest segment, so that a
// lost end is noticed.
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
#include "daemon/runtime/owned_file.hpp"

namespace slamgw {

/// An operation on the log has failed; what() names the file and the reason.
class LogError : public std::runtime_error {
 public:
  /// `error`: an errno.
  LogError(const std::string& what, int error);
  /// Returns true when the disk failed, perhaps only for a moment.
  bool is_io_error() const { return is_io_error_; }

 private:
  bool is_io_error_;
};

class RecordLog {
 public:
  /// Records that open() found missing. If a list of erased records is damaged too, it is uncertain
  /// how many of the missing records were still needed.
  struct Summary {
    std::size_t lost_at_least = 0;
    std::size_t lost_at_most = 0;
    std::string where;       ///< the first damaged file
    std::size_t strays = 0;  ///< segments of other logs, and copies; none of them is read
  };

  /// Makes the directory (0700), and locks the log; waits up to 3 s for an earlier process. On a
  /// read-only file system, the log can be read only. Throws LogError.
  RecordLog(std::string directory, std::uint32_t segment_bytes);

  /// Reads the whole log. Call once, before the other members. `skips_unreadable`: data that the
  /// disk cannot read are lost; else LogError is thrown for them. Throws LogError also for a log of
  /// a newer version.
  Summary open(bool skips_unreadable);

  /// Collects a record, or an erasure, for the next commit. `content` is not empty.
  void put(std::uint64_t key, Bytes content) { puts_.emplace_back(key, std::move(content)); }
  void erase(std::uint64_t key) { erasures_.push_back(key); }
  /// Writes the collected records, then erases. Throws LogError, and then has done neither.
  /// `is_durable`: the commit survives a power cut, else only the end of the process. An erasure
  /// that cannot be written is written with a later one; until then a new process finds the record
  /// again.
  void commit(bool is_durable);
  /// Returns true while an erasure could not be written.
  bool owes_erasures() const;

  /// Returns the content; nothing when there is no record, or it is damaged. Throws LogError when
  /// the disk fails, unless `skips_unreadable`.
  std::optional<Bytes> read(std::uint64_t key, bool skips_unreadable = false) const;
  bool has(std::uint64_t key) const { return find(key) != nullptr; }
  /// Returns the size of the content; 0 when there is no record.
  std::uint32_t bytes_of(std::uint64_t key) const;
  /// Returns the first key above `after`.
  std::optional<std::uint64_t> next(std::uint64_t after) const;
  /// Returns at least the highest key that was ever written.
  std::uint64_t last_key() const { return last_key_; }

  /// Returns true while the log can be read only.
  bool is_read_only() const { return is_read_only_; }

  /// Restores segments, their lists and the tally that were moved, removed or replaced while they
  /// were open. Returns the paths of the restored segments. Call before each write. Throws
  /// LogError, also while the file system is read-only.
  std::vector<std::string> put_back_in_place();

  /// Makes durable what earlier commits have written without `is_durable`. Throws LogError; the
  /// next call then tries again.
  void synchronise();

 private:
  struct Segment {
    OwnedFile file;
    std::uint32_t bytes = 0;
    std::uint32_t records = 0;           ///< ever written
    std::uint32_t live = 0;              ///< not erased: entries of the index
    std::vector<std::uint32_t> unsaved;  ///< entries to add to the list of erased records
    /// The disk did not take it when it was last synchronised. Linux then takes its pages for
    /// written, so they must be written again.
    bool is_unsure = false;
  };
  /// The place of a key's record.
  struct Entry {
    std::uint64_t key = 0;
    std::uint32_t segment = 0;
    std::uint32_t offset = 0;  ///< 0: the record is erased
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
  void open_for_writing();
  std::map<std::uint32_t, std::string> find_segments();
  std::map<std::uint32_t, std::string> put_under_their_numbers(
      const std::map<std::uint32_t, std::string>& named);
  Scan scan(std::uint32_t number, bool skips_unreadable);
  void note_missing(std::uint32_t number, const Scan& scan, Segment& segment,
                    Summary& summary) const;
  void note_missing_segments(std::uint64_t found, Summary& summary) const;
  std::uint64_t size() const { return entries_.size() - erased_; }
  const Entry* find(std::uint64_t key) const;
  Entry* find(std::uint64_t key) { return const_cast<Entry*>(std::as_const(*this).find(key)); }
  void set(const Entry& entry);
  void mark_erased(const Entry& entry);
  std::optional<Bytes> read(const Entry& entry, bool skips_unreadable) const;
  Segment& newest() { return segments_.rbegin()->second; }
  Bytes header_of(std::uint32_t number) const;
  void create_segment(std::uint32_t number);
  void append(const Changes& puts, bool is_durable);
  /// Returns the segment with the most erased bytes, when there are too many of them on disk.
  std::optional<std::uint32_t> sparse_segment() const;
  void move_records_of(std::uint32_t segment, bool is_durable);
  void save_all_erased(bool is_durable);
  void save_erased(std::uint32_t number, Segment& segment, bool is_durable);
  void restore_erased(std::uint32_t number, Segment& segment);
  void remove_dead_segments();
  void shorten_newest();
  bool write_tally();
  std::optional<Tally> read_tally();
  std::string path_of(std::uint32_t number) const;
  std::uint32_t checksum_of(std::uint32_t segment, const Header& header) const;
  std::uint32_t checksum(std::initializer_list<std::uint32_t> numbers, ByteView octets = {}) const;
  [[noreturn]] void fail(const std::string& path) const;

  const std::string directory_;
  const std::uint32_t segment_bytes_;
  std::uint64_t id_ = 0;
  std::size_t strays_ = 0;
  bool is_read_only_ = false;
  OwnedFile tally_file_;
  std::optional<Tally> tally_;
  Segments segments_;
  std::deque<Entry> entries_;  // keys rise
  std::size_t erased_ = 0;     // of entries_
  std::uint64_t last_key_ = 0;
  Changes puts_;
  std::vector<std::uint64_t> erasures_;
  std::set<std::uint32_t> unsynchronised_;  // segments that are written, not yet durable
  bool needs_segment_ = true;               // the next record begins a new segment
  std::uint32_t next_segment_ = 1;          // number of the next new segment
};

}  // namespace slamgw
