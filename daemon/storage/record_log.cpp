// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/record_log.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>
#include <algorithm>
#include <boost/crc.hpp>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <random>
#include <set>
#include <thread>
#include <tuple>

namespace slamgw {
namespace {

namespace fs = std::filesystem;

/// A segment's first octets: the last one is the version of the format.
constexpr std::string_view magic = "slamgwL1";
constexpr std::size_t header_bytes = 32;  // magic, number, records before, highest key (8), 0, sum
/// Checksum of the rest, size, index in the segment, checksum of the content, key (8).
constexpr std::size_t record_header_bytes = 24;
constexpr std::size_t erased_bytes = 8;  // offset, checksum
constexpr std::size_t tally_bytes = 32;  // segment, records, live (8), id (8), 0, checksum
constexpr std::uint32_t unknown_records = 0xffffffff;
/// Not an offset: from this number on, entries of a list of erased records stand for lost records
/// that were reported.
constexpr std::uint32_t reported_loss = 0x80000000;
/// Unit in which the disk reads or fails to read.
constexpr std::size_t block_bytes = 4096;
/// A segment's records are moved once erased records take more than half the size of the others
/// plus this many segments.
constexpr std::uint64_t spare_segments = 4;
/// Larger than any file of the log; of a larger file only this much is read.
constexpr std::size_t max_file_bytes = 64u << 20;
constexpr std::chrono::milliseconds lock_patience{3000};
constexpr std::chrono::milliseconds lock_poll{50};

std::uint32_t u32_at(ByteView octets, std::size_t offset) {
  return ByteReader(octets.subspan(offset)).read_u32_le();
}
std::uint64_t u64_at(ByteView octets, std::size_t offset) {
  return ByteReader(octets.subspan(offset)).read_u64_le();
}

/// Returns false, with errno, when not all octets were written.
bool write_at(int file, ByteView octets, std::size_t offset) {
  while (!octets.empty()) {
    const ssize_t written =
        ::pwrite(file, octets.data(), octets.size(), static_cast<off_t>(offset));
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return false;
    octets = octets.subspan(static_cast<std::size_t>(written));
    offset += static_cast<std::size_t>(written);
  }
  return true;
}

/// Returns the number of octets read, which is less than asked for at the end of the file. Returns
/// -1, with errno, on failure.
ssize_t read_at(int file, std::span<std::uint8_t> into, std::size_t offset) {
  std::size_t done = 0;
  while (done < into.size()) {
    const ssize_t count =
        ::pread(file, into.data() + done, into.size() - done, static_cast<off_t>(offset + done));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return -1;
    if (count == 0) break;
    done += static_cast<std::size_t>(count);
  }
  return static_cast<ssize_t>(done);
}

/// Returns the whole file. `skips_unreadable`: blocks that the disk cannot read are zero. Returns
/// nothing, with errno, when reading fails otherwise, or no block could be read.
std::optional<Bytes> read_file(int file, bool skips_unreadable) {
  struct stat status {};
  if (fstat(file, &status) != 0) return std::nullopt;
  Bytes octets(std::min(static_cast<std::size_t>(status.st_size), max_file_bytes));
  if (read_at(file, octets, 0) >= 0) return octets;
  if (!skips_unreadable || errno != EIO) return std::nullopt;
  bool is_readable = false;
  for (std::size_t at = 0; at < octets.size(); at += block_bytes) {
    const std::size_t size = std::min(block_bytes, octets.size() - at);
    if (read_at(file, std::span(octets).subspan(at, size), at) >= 0)
      is_readable = true;
    else
      std::fill_n(octets.begin() + static_cast<std::ptrdiff_t>(at), size, 0);
  }
  errno = EIO;
  return is_readable ? std::optional(std::move(octets)) : std::nullopt;
}

/// Opens like open(2), but only regular files. A link may lead to another user's file, and opening
/// a FIFO may block.
OwnedFile open_file(const std::string& path, int flags) {
  OwnedFile file(::open(path.c_str(), flags | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC, 0600));
  struct stat status {};
  if (file.get() < 0 || fstat(file.get(), &status) != 0 || S_ISREG(status.st_mode)) return file;
  file = OwnedFile();
  errno = EINVAL;
  return file;
}

/// Opens for writing, or for reading only where the file system is read-only (`is_read_only`).
OwnedFile open_or_read(const std::string& path, int flags, bool& is_read_only) {
  OwnedFile file = open_file(path, O_RDWR | flags);
  if (file.get() >= 0 || errno != EROFS) return file;
  is_read_only = true;
  file = open_file(path, O_RDONLY);
  errno = EROFS;
  return file;
}

bool is_same_file(const std::string& path, int file) {
  struct stat named {
  }, open{};
  return stat(path.c_str(), &named) == 0 && fstat(file, &open) == 0 &&
         named.st_ino == open.st_ino && named.st_dev == open.st_dev;
}

/// Makes renames and new files in `directory` durable.
void synchronise_directory(const std::string& directory) {
  const OwnedFile entry(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (entry.get() >= 0) fsync(entry.get());
}

/// Parses `<number>-<id>.log`.
std::optional<std::pair<std::uint32_t, std::uint64_t>> parse_name(const std::string& name) {
  unsigned number = 0;
  unsigned long long id = 0;
  int end = 0;
  if (std::sscanf(name.c_str(), "%8u-%16llx.log%n", &number, &id, &end) != 2) return std::nullopt;
  if (end == 0 || static_cast<std::size_t>(end) != name.size()) return std::nullopt;
  return std::pair{number, id};
}

}  // namespace

LogError::LogError(const std::string& what, int error)
    : std::runtime_error(error == 0        ? what
                         : error == ENOSPC ? what + ": the disk is full: free space there"
                         : error == EINVAL ? what + ": it is not a regular file: remove it"
                                           : fmt::format("{}: {}", what, std::strerror(error))),
      is_io_error_(error == EIO) {}

/// The header in front of each record.
struct RecordLog::Header {
  std::uint32_t sum = 0;
  std::uint32_t size = 0;
  std::uint32_t index = 0;
  std::uint32_t content_sum = 0;
  std::uint64_t key = 0;

  static Header read(ByteView octets) {
    ByteReader in(octets);
    Header header;
    header.sum = in.read_u32_le();
    header.size = in.read_u32_le();
    header.index = in.read_u32_le();
    header.content_sum = in.read_u32_le();
    header.key = in.read_u64_le();
    return header;
  }
};

/// The contents of a segment's two files.
struct RecordLog::Scan {
  struct Record {
    Entry entry;
    std::uint32_t index = 0;
  };
  std::uint32_t bytes = 0;
  std::uint32_t records_before = unknown_records;
  std::vector<Record> intact;
  std::uint32_t records = 0;  ///< ever written, as far as this file shows
  std::set<std::uint32_t> erased;
  std::size_t unread_erased = 0;  ///< upper bound of damaged entries in the list of erased records
};

RecordLog::RecordLog(std::string directory, std::uint32_t segment_bytes)
    : directory_(std::move(directory)), segment_bytes_(segment_bytes) {
  make_directory();
  lock();
}

void RecordLog::fail(const std::string& path) const { throw LogError(path, errno); }

/// Makes the log's directory and those above it.
void RecordLog::make_directory() const {
  const fs::path above = fs::path(directory_).parent_path();
  std::error_code error;
  fs::create_directories(above.parent_path(), error);
  for (const std::string& path : {above.string(), directory_})
    if (mkdir(path.c_str(), 0700) != 0 && errno != EEXIST) fail(path);
}

void RecordLog::lock() {
  const std::string path = directory_ + "/tally";
  is_read_only_ = false;
  OwnedFile file = open_or_read(path, O_CREAT, is_read_only_);
  if (file.get() < 0) fail(path);
  const auto give_up_at = std::chrono::steady_clock::now() + lock_patience;
  while (flock(file.get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) fail(path);
    if (std::chrono::steady_clock::now() > give_up_at)
      throw LogError(directory_ +
                         ": another process uses it, perhaps a second slam-gatewayd: stop one of "
                         "them",
                     0);
    std::this_thread::sleep_for(lock_poll);
  }
  tally_file_ = std::move(file);
}

std::string RecordLog::path_of(std::uint32_t number) const {
  return fmt::format("{}/{:08}-{:016x}.log", directory_, number, id_);
}

std::uint32_t RecordLog::checksum_of(std::uint32_t segment, const Header& header) const {
  return checksum({segment, header.size, header.index, header.content_sum,
                   static_cast<std::uint32_t>(header.key),
                   static_cast<std::uint32_t>(header.key >> 32)});
}

std::uint32_t RecordLog::checksum(std::initializer_list<std::uint32_t> numbers,
                                  ByteView octets) const {
  boost::crc_32_type crc;
  const auto add = [&crc](std::uint32_t number) {
    for (unsigned shift = 0; shift < 32; shift += 8)
      crc.process_byte(static_cast<std::uint8_t>(number >> shift));
  };
  add(static_cast<std::uint32_t>(id_));
  add(static_cast<std::uint32_t>(id_ >> 32));
  for (const std::uint32_t number : numbers) add(number);
  crc.process_bytes(octets.data(), octets.size());
  return crc.checksum();
}

/// Also finds the log's id: the tally's, else the id that most files have, else a random one.
std::map<std::uint32_t, std::string> RecordLog::find_segments() {
  std::map<std::uint64_t, std::map<std::uint32_t, std::string>> by_id;
  std::error_code error;
  for (fs::directory_iterator entry(directory_, error), end; entry != end && !error;
       entry.increment(error)) {
    const auto name = parse_name(entry->path().filename().string());
    std::error_code none;
    if (name && entry->is_regular_file(none))
      by_id[name->second][name->first] = entry->path().string();
  }
  if (error) throw LogError(directory_, error.value());
  std::array<std::uint8_t, tally_bytes> octets{};
  if (read_at(tally_file_.get(), octets, 0) == static_cast<ssize_t>(octets.size())) {
    id_ = u64_at(octets, 16);
    tally_ = read_tally();
  }
  const auto largest =
      std::ranges::max_element(by_id, {}, [](const auto& of_id) { return of_id.second.size(); });
  if (!tally_ && largest != by_id.end()) id_ = largest->first;
  std::random_device random;
  while (!tally_ && by_id.empty() && (id_ = std::uint64_t{random()} << 32 | random()) == 0) {
  }
  for (const auto& [id, files] : by_id) strays_ += id == id_ ? 0 : files.size();
  return put_under_their_numbers(by_id[id_]);
}

/// Renames segments whose header has another number than their name. Puts them aside if there is
/// one of that number: they are copies, and their headers describe other segments.
std::map<std::uint32_t, std::string> RecordLog::put_under_their_numbers(
    const std::map<std::uint32_t, std::string>& named) {
  std::map<std::uint32_t, std::string> segments;
  for (const auto& [number, path] : named) {
    std::array<std::uint8_t, header_bytes> header{};
    const OwnedFile file = open_file(path, O_RDONLY);
    const bool is_whole =
        file.get() >= 0 && read_at(file.get(), header, 0) == static_cast<ssize_t>(header.size()) &&
        checksum({}, ByteView(header).first(header_bytes - 4)) == u32_at(header, header_bytes - 4);
    const std::uint32_t own = is_whole ? u32_at(header, 8) : number;
    if (own != number && (named.contains(own) || segments.contains(own))) {
      ++strays_;
      std::ignore = ::rename(path.c_str(), (path + ".stray").c_str());
      continue;
    }
    const bool is_misplaced = own != number && ::rename(path.c_str(), path_of(own).c_str()) == 0;
    if (is_misplaced)
      std::ignore = ::rename((path + ".erased").c_str(), (path_of(own) + ".erased").c_str());
    segments[is_misplaced ? own : number] = is_misplaced ? path_of(own) : path;
  }
  return segments;
}

RecordLog::Summary RecordLog::open(bool skips_unreadable) {
  Summary summary;
  std::vector<Entry> found;
  for (const auto& [number, path] : find_segments()) {
    Segment segment;
    segment.file = open_or_read(path, 0, is_read_only_);
    if (segment.file.get() < 0) fail(path);
    segments_.emplace(number, std::move(segment));
    next_segment_ = number + 1;
  }
  // The newest first, because each header has the count of the segment before.
  std::pair<std::uint32_t, std::uint32_t> counted{0, unknown_records};  // segment, its records
  for (auto one = segments_.rbegin(); one != segments_.rend(); ++one) {
    auto& [number, segment] = *one;
    const Scan scanned = scan(number, skips_unreadable);
    const bool is_known = counted.first == number && counted.second != unknown_records;
    segment.bytes = scanned.bytes;
    segment.records = is_known ? counted.second : scanned.records;
    counted = {number - 1, scanned.records_before};
    if (one == segments_.rbegin() && tally_ && tally_->segment == number)
      segment.records = std::max(segment.records, tally_->records);
    note_missing(number, scanned, segment, summary);
    for (const auto& [entry, index] : scanned.intact) {
      if (index >= segment.records) break;  // the record's commit failed
      last_key_ = std::max(last_key_, entry.key);
      if (!scanned.erased.contains(entry.offset)) found.push_back(entry);
    }
  }
  if (tally_) next_segment_ = std::max(next_segment_, tally_->segment + 1);
  note_missing_segments(found.size(), summary);
  std::ranges::sort(found, {}, [](const Entry& entry) {
    return std::tuple(entry.key, entry.segment, entry.offset);
  });
  for (const Entry& entry : found) {
    ++segments_.at(entry.segment).live;
    set(entry);
  }
  for (auto& [number, segment] : segments_) {
    unsynchronised_.insert(number);  // the former process may have been killed before it did
    if (!segment.unsaved.empty()) save_erased(number, segment, false);
  }
  remove_dead_segments();
  if (!is_read_only_ && !write_tally()) fail(directory_);
  summary.strays = strays_;
  return summary;
}

RecordLog::Scan RecordLog::scan(std::uint32_t number, bool skips_unreadable) {
  const std::string path = path_of(number);
  Scan scan;
  const auto octets = read_file(segments_.at(number).file.get(), skips_unreadable);
  if (!octets) fail(path);
  const ByteView all(*octets);
  scan.bytes = static_cast<std::uint32_t>(all.size());
  if (all.size() >= header_bytes &&
      checksum({}, all.first(header_bytes - 4)) == u32_at(all, header_bytes - 4)) {
    const std::string_view found = as_text(all.first(magic.size()));
    if (found != magic)
      throw LogError(fmt::format("{} was written by a newer version (format {}, supported: {}) and "
                                 "is not changed",
                                 path, found.back(), magic.back()),
                     0);
    scan.records_before = u32_at(all, 12);
    last_key_ = std::max(last_key_, u64_at(all, 16));
  }
  // Goes from record to record, and from octet to octet where there is no whole record.
  std::size_t end = header_bytes;
  for (std::size_t at = header_bytes; at + record_header_bytes < all.size();) {
    const Header header = Header::read(all.subspan(at));
    const bool is_possible = header.size > 0 &&
                             header.size <= all.size() - at - record_header_bytes &&
                             header.index >= scan.records &&
                             header.index - scan.records <= (at - end) / (record_header_bytes + 1);
    const bool is_whole =
        is_possible && header.sum == checksum_of(number, header) &&
        header.content_sum == checksum({}, all.subspan(at + record_header_bytes, header.size));
    if (!is_whole) {
      ++at;
      continue;
    }
    const auto offset = static_cast<std::uint32_t>(at);
    scan.intact.push_back({{header.key, number, offset, header.size}, header.index});
    scan.records = header.index + 1;
    end = at += record_header_bytes + header.size;
  }
  const OwnedFile erased = open_file(path + ".erased", O_RDONLY);
  if (erased.get() < 0) {
    if (errno == ENOENT) return scan;
    fail(path + ".erased");
  }
  auto list = read_file(erased.get(), skips_unreadable);
  if (!list && !skips_unreadable) fail(path + ".erased");
  std::size_t damaged = 0;
  for (std::size_t at = 0; list && at < list->size();) {
    const bool is_entry = at + erased_bytes <= list->size() &&
                          u32_at(*list, at + 4) == checksum({number, u32_at(*list, at)});
    if (is_entry) scan.erased.insert(u32_at(*list, at));
    damaged += is_entry ? 0 : 1;
    at += is_entry ? erased_bytes : 1;
  }
  scan.unread_erased = (damaged + erased_bytes - 1) / erased_bytes;
  return scan;
}

void RecordLog::note_missing(std::uint32_t number, const Scan& scan, Segment& segment,
                             Summary& summary) const {
  const std::uint32_t written = segment.records;
  std::set<std::uint32_t> known = scan.erased;
  for (const Scan::Record& record : scan.intact)
    if (record.index < written) known.insert(record.entry.offset);
  const std::size_t missing = written - std::min<std::size_t>(written, known.size());
  if (missing == 0) return;
  summary.lost_at_most += missing;
  summary.lost_at_least += missing - std::min(missing, scan.unread_erased);
  summary.where = path_of(number);
  for (std::uint32_t mark = reported_loss; segment.unsaved.size() < missing; ++mark)
    if (!scan.erased.contains(mark)) segment.unsaved.push_back(mark);
}

/// Notes the loss of whole segments, which only the tally shows.
void RecordLog::note_missing_segments(std::uint64_t found, Summary& summary) const {
  if (!tally_) return;
  const bool is_current = segments_.empty() || segments_.rbegin()->first < tally_->segment ||
                          (segments_.rbegin()->first == tally_->segment &&
                           segments_.rbegin()->second.records <= tally_->records);
  if (!is_current || tally_->live <= found) return;
  const std::size_t missing = tally_->live - found;
  if (missing <= summary.lost_at_least) return;
  if (summary.where.empty()) summary.where = directory_;
  summary.lost_at_least = missing;
  summary.lost_at_most = std::max(summary.lost_at_most, missing);
}

const RecordLog::Entry* RecordLog::find(std::uint64_t key) const {
  const auto found = std::ranges::lower_bound(entries_, key, {}, &Entry::key);
  return found != entries_.end() && found->key == key && found->offset != 0 ? &*found : nullptr;
}

std::optional<std::uint64_t> RecordLog::next(std::uint64_t after) const {
  auto found = std::ranges::upper_bound(entries_, after, {}, &Entry::key);
  while (found != entries_.end() && found->offset == 0) ++found;
  return found == entries_.end() ? std::nullopt : std::optional(found->key);
}

std::uint32_t RecordLog::bytes_of(std::uint64_t key) const {
  const Entry* const entry = find(key);
  return entry ? entry->bytes : 0;
}

/// Puts the entry into the index, and marks an older record of the key as erased.
void RecordLog::set(const Entry& entry) {
  last_key_ = std::max(last_key_, entry.key);
  const auto place = std::ranges::lower_bound(entries_, entry.key, {}, &Entry::key);
  if (place == entries_.end() || place->key != entry.key) {
    entries_.insert(place, entry);
    return;
  }
  if (place->offset == 0) {
    --erased_;
  } else {
    mark_erased(*place);
  }
  *place = entry;
}

/// Adds the record to its segment's list of erased records, which is written later.
void RecordLog::mark_erased(const Entry& entry) {
  const auto segment = segments_.find(entry.segment);
  if (segment == segments_.end()) return;  // move_records_of() found the record damaged
  --segment->second.live;
  segment->second.unsaved.push_back(entry.offset);
}

void RecordLog::commit(bool is_durable) {
  const Changes puts = std::exchange(puts_, {});
  const auto erased = std::exchange(erasures_, {});
  append(puts, is_durable);
  for (const std::uint64_t key : erased) {
    Entry* const entry = find(key);
    if (!entry) continue;
    mark_erased(*entry);
    entry->offset = 0;
    ++erased_;
  }
  const auto is_erased = [](const Entry& entry) { return entry.offset == 0; };
  for (; !entries_.empty() && is_erased(entries_.front()); --erased_) entries_.pop_front();
  if (2 * erased_ > entries_.size()) erased_ -= std::erase_if(entries_, is_erased);
  save_all_erased(is_durable);
  if (const auto segment = sparse_segment()) move_records_of(*segment, is_durable);
}

void RecordLog::append(const Changes& puts, bool is_durable) {
  if (puts.empty()) return;
  const bool is_new = needs_segment_ || newest().bytes >= segment_bytes_;
  if (is_new) create_segment(next_segment_);
  auto& [number, segment] = *segments_.rbegin();
  std::vector<Entry> placed;
  ByteWriter out;
  for (const auto& [key, content] : puts) {
    const auto at = segment.bytes + static_cast<std::uint32_t>(out.bytes().size());
    Header header;
    header.size = static_cast<std::uint32_t>(content.size());
    header.index = segment.records + static_cast<std::uint32_t>(placed.size());
    header.content_sum = checksum({}, content);
    header.key = key;
    out.write_u32_le(checksum_of(number, header)).write_u32_le(header.size);
    out.write_u32_le(header.index).write_u32_le(header.content_sum).write_u64_le(key);
    out.write(content);
    placed.push_back({key, number, at, header.size});
  }
  if (!write_at(segment.file.get(), out.bytes(), segment.bytes) ||
      (is_durable && fdatasync(segment.file.get()) != 0)) {
    // How much of it the disk has is unknown, so nothing more is written to this segment.
    const int error = errno;
    const std::string path = path_of(number);
    needs_segment_ = true;
    // An ext2 that cannot read where the blocks of a file are loses them when it is shortened.
    if (error == EIO || error == ENOMEM)
      std::ignore = write_at(segment.file.get(), Bytes(out.bytes().size()), segment.bytes);
    else
      std::ignore = ftruncate(segment.file.get(), segment.bytes);
    if (is_new) {  // else each retry would leave a file and a descriptor
      ::unlink(path.c_str());
      next_segment_ = number;
      segments_.erase(next_segment_);
    }
    throw LogError(path, error);
  }
  if (is_new && is_durable) synchronise_directory(directory_);
  if (!is_durable) unsynchronised_.insert(number);
  segment.bytes += static_cast<std::uint32_t>(out.bytes().size());
  segment.records += static_cast<std::uint32_t>(placed.size());
  segment.live += static_cast<std::uint32_t>(placed.size());
  for (const Entry& entry : placed) set(entry);
  write_tally();
}

Bytes RecordLog::header_of(std::uint32_t number) const {
  const auto before = segments_.find(number - 1);
  ByteWriter header;
  header.write(magic).write_u32_le(number);
  header.write_u32_le(before != segments_.end() ? before->second.records : unknown_records);
  header.write_u64_le(last_key_).write_u32_le(0);
  header.write_u32_le(checksum({}, header.bytes()));
  return header.take();
}

void RecordLog::create_segment(std::uint32_t number) {
  const std::string path = path_of(number);
  OwnedFile file = open_file(path, O_RDWR | O_CREAT | O_TRUNC);
  if (file.get() < 0) fail(path);
  if (!write_at(file.get(), header_of(number), 0)) {
    const int error = errno;
    ::unlink(path.c_str());
    throw LogError(path, error);
  }
  Segment segment;
  segment.file = std::move(file);
  segment.bytes = header_bytes;
  segments_.emplace(number, std::move(segment));
  next_segment_ = number + 1;
  needs_segment_ = false;
}

bool RecordLog::owes_erasures() const {
  return std::ranges::any_of(segments_,
                             [](const auto& one) { return !one.second.unsaved.empty(); });
}

void RecordLog::save_all_erased(bool is_durable) {
  // The tally is written first: if it still counted erased records, open() would report a loss.
  if (owes_erasures() && write_tally() && is_durable) fdatasync(tally_file_.get());
  const auto save_lists = [&](bool of_dead) {
    for (auto& [number, segment] : segments_) {
      const bool is_dead = segment.live == 0 && &segment != &newest();
      if (is_dead == of_dead && !segment.unsaved.empty()) save_erased(number, segment, is_durable);
    }
  };
  save_lists(false);
  remove_dead_segments();
  save_lists(true);  // of segments that could not be removed
  shorten_newest();
}

void RecordLog::save_erased(std::uint32_t number, Segment& segment, bool is_durable) {
  const OwnedFile list = open_file(path_of(number) + ".erased", O_WRONLY | O_CREAT | O_APPEND);
  ByteWriter entries;
  for (const std::uint32_t offset : segment.unsaved)
    entries.write_u32_le(offset).write_u32_le(checksum({number, offset}));
  const auto size = static_cast<ssize_t>(entries.bytes().size());
  if (list.get() < 0 || ::write(list.get(), entries.bytes().data(), entries.bytes().size()) != size)
    return;
  if (!is_durable) unsynchronised_.insert(number);
  if (!is_durable || fdatasync(list.get()) == 0) segment.unsaved.clear();
}

/// Keeps the newest segment, because its header has the highest key. Keeps all segments while the
/// records that replace theirs cannot be made durable.
void RecordLog::remove_dead_segments() {
  const auto is_dead = [](const auto& one) { return one.second.live == 0; };
  if (segments_.empty() || std::none_of(segments_.begin(), std::prev(segments_.end()), is_dead))
    return;
  try {
    if (!unsynchronised_.empty()) synchronise();
  } catch (const LogError&) {
    return;
  }
  for (auto one = segments_.begin(); std::next(one) != segments_.end();) {
    if (one->second.live > 0) {
      ++one;
      continue;
    }
    ::unlink(path_of(one->first).c_str());
    ::unlink((path_of(one->first) + ".erased").c_str());
    one = segments_.erase(one);
  }
}

/// Takes back the room of the newest segment once its records are erased, if the next record begins
/// a new segment. On a full disk there may be no other room, neither for the list of erased records
/// nor for a new segment.
void RecordLog::shorten_newest() {
  if (segments_.empty() || !(needs_segment_ || newest().bytes >= segment_bytes_)) return;
  auto& [number, segment] = *segments_.rbegin();
  if (segment.live > 0 || segment.bytes <= header_bytes) return;
  needs_segment_ = true;
  const std::uint32_t records = std::exchange(segment.records, 0);
  // Else a power cut could leave the old tally beside the short segment: records would seem lost.
  if (!write_tally() || fdatasync(tally_file_.get()) != 0 ||
      !write_at(segment.file.get(), header_of(number), 0) ||
      ftruncate(segment.file.get(), header_bytes) != 0) {
    segment.records = records;
    return;
  }
  segment.bytes = header_bytes;
  segment.unsaved.clear();
  ::unlink((path_of(number) + ".erased").c_str());
}

std::optional<Bytes> RecordLog::read(std::uint64_t key, bool skips_unreadable) const {
  const Entry* const entry = find(key);
  return entry ? read(*entry, skips_unreadable) : std::nullopt;
}

std::optional<Bytes> RecordLog::read(const Entry& entry, bool skips_unreadable) const {
  const auto found = segments_.find(entry.segment);
  if (found == segments_.end()) return std::nullopt;
  Bytes record(record_header_bytes + entry.bytes);
  const ssize_t count = read_at(found->second.file.get(), record, entry.offset);
  if (count < 0 && !skips_unreadable) fail(path_of(entry.segment));
  const Header header = Header::read(record);
  const ByteView content = ByteView(record).subspan(record_header_bytes);
  const bool is_whole = count == static_cast<ssize_t>(record.size()) && header.key == entry.key &&
                        header.size == entry.bytes &&
                        header.sum == checksum_of(entry.segment, header) &&
                        header.content_sum == checksum({}, content);
  if (!is_whole) return std::nullopt;
  return Bytes(content.begin(), content.end());
}

/// Moves the live records to the newest segment, so that a few old records do not keep a segment.
void RecordLog::move_records_of(std::uint32_t segment, bool is_durable) {
  Changes moved;
  std::vector<Entry*> damaged;
  try {
    for (Entry& entry : entries_) {
      if (entry.segment != segment || entry.offset == 0) continue;
      if (auto content = read(entry, false)) {
        moved.emplace_back(entry.key, std::move(*content));
      } else {
        damaged.push_back(&entry);
      }
    }
    append(moved, is_durable);
  } catch (const LogError&) {
    return;  // the disk fails: the records stay where they are
  }
  for (Entry* const entry : damaged) {
    mark_erased(*entry);
    entry->segment = 0;  // read() returns nothing for it, as for any damaged record
  }
  save_all_erased(is_durable);
}

std::optional<std::uint32_t> RecordLog::sparse_segment() const {
  std::uint64_t bytes = 0;
  std::uint64_t used = 0;
  std::uint64_t most_erased = 0;
  std::optional<std::uint32_t> sparsest;
  for (const auto& [number, segment] : segments_) {
    const std::uint64_t live = std::uint64_t{segment.bytes} * segment.live;
    const std::uint64_t erased = segment.bytes - live / std::max(1U, segment.records);
    bytes += segment.bytes;
    used += segment.bytes - erased;
    if (erased <= most_erased || number == segments_.rbegin()->first) continue;
    most_erased = erased;
    sparsest = number;
  }
  const bool is_sparse = bytes > used + used / 2 + spare_segments * segment_bytes_;
  return is_sparse ? sparsest : std::nullopt;
}

/// Writes the tally in one write, so that a killed process leaves either the old or the new tally.
/// After a failure the tally is older than the log; then only a lost end goes unnoticed.
bool RecordLog::write_tally() {
  ByteWriter tally;
  tally.write_u32_le(segments_.empty() ? next_segment_ - 1 : segments_.rbegin()->first);
  tally.write_u32_le(segments_.empty() ? 0 : newest().records);
  tally.write_u64_le(size()).write_u64_le(id_).write_u32_le(0);
  tally.write_u32_le(checksum({}, tally.bytes()));
  return write_at(tally_file_.get(), tally.bytes(), 0);
}

std::optional<RecordLog::Tally> RecordLog::read_tally() {
  std::array<std::uint8_t, tally_bytes> octets{};
  if (read_at(tally_file_.get(), octets, 0) != static_cast<ssize_t>(octets.size()))
    return std::nullopt;
  const ByteView all(octets);
  if (checksum({}, all.first(tally_bytes - 4)) != u32_at(all, tally_bytes - 4)) return std::nullopt;
  return Tally{u32_at(all, 0), u32_at(all, 4), u64_at(all, 8)};
}

void RecordLog::synchronise() {
  for (; !unsynchronised_.empty(); unsynchronised_.erase(unsynchronised_.begin())) {
    const std::uint32_t number = *unsynchronised_.begin();
    const auto segment = segments_.find(number);
    if (segment == segments_.end()) continue;
    const int file = segment->second.file.get();
    if (std::exchange(segment->second.is_unsure, true)) {
      const auto octets = read_file(file, false);
      if (!octets || !write_at(file, *octets, 0)) fail(path_of(number));
    }
    if (fdatasync(file) != 0) fail(path_of(number));
    segment->second.is_unsure = false;
    const OwnedFile list = open_file(path_of(number) + ".erased", O_WRONLY);
    if (list.get() >= 0 && fdatasync(list.get()) != 0) fail(path_of(number) + ".erased");
  }
  synchronise_directory(directory_);
}

/// Completes the segment's list of erased records, which may be gone, from the index. Does so
/// before the segment is back: without its list, a new process would find erased records again.
void RecordLog::restore_erased(std::uint32_t number, Segment& segment) {
  const Scan found = scan(number, false);
  for (const auto& [entry, index] : found.intact) {
    if (index >= segment.records) break;  // the record's commit failed
    const Entry* const known = find(entry.key);
    const bool is_live = known && known->segment == number && known->offset == entry.offset;
    if (!is_live && !found.erased.contains(entry.offset)) segment.unsaved.push_back(entry.offset);
  }
  if (!segment.unsaved.empty()) save_erased(number, segment, true);
}

/// Opens the files of a log that could only be read. Leaves a replaced segment as it is, because
/// put_back_in_place() opens a new one.
void RecordLog::open_for_writing() {
  const std::string tally = directory_ + "/tally";
  if (open_file(tally, O_RDWR | O_CREAT).get() < 0) fail(tally);
  for (auto& [number, segment] : segments_) {
    const std::string path = path_of(number);
    if (!is_same_file(path, segment.file.get())) continue;
    OwnedFile file = open_file(path, O_RDWR);
    if (file.get() < 0) fail(path);
    segment.file = std::move(file);
  }
  tally_file_ = OwnedFile();  // it holds the lock
  lock();
}

std::vector<std::string> RecordLog::put_back_in_place() {
  std::vector<std::string> written;
  if (is_read_only_) open_for_writing();
  for (auto& [number, segment] : segments_) {
    const std::string path = path_of(number);
    if (is_same_file(path, segment.file.get())) continue;
    make_directory();
    const auto octets = read_file(segment.file.get(), false);
    if (!octets) fail(path);
    const std::string copy = path + ".new";
    OwnedFile file = open_file(copy, O_RDWR | O_CREAT | O_TRUNC);
    if (file.get() < 0 || !write_at(file.get(), *octets, 0) || fdatasync(file.get()) != 0)
      fail(copy);
    restore_erased(number, segment);
    std::ignore = ::rename(path.c_str(), (path + ".replaced").c_str());
    if (::rename(copy.c_str(), path.c_str()) != 0) fail(path);
    segment.file = std::move(file);
    written.push_back(path);
  }
  const bool is_tally_gone = !is_same_file(directory_ + "/tally", tally_file_.get());
  if (is_tally_gone) {
    make_directory();
    lock();
    write_tally();
  }
  if (is_tally_gone || !written.empty()) synchronise_directory(directory_);
  return written;
}

}  // namespace slamgw
