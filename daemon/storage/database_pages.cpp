// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/database_pages.hpp"

#include <algorithm>
#include <optional>

namespace slamgw {
namespace {

constexpr std::size_t log_header_bytes = 32;
constexpr std::size_t frame_header_bytes = 24;
constexpr std::uint32_t log_magic = 0x377f0682;  // the last bit says: checksums of big-endian words
/// Parts in which a page is read that cannot be read at once.
constexpr std::size_t sector_bytes = 512;

std::uint32_t u32_be(ByteView bytes, std::size_t at) {
  return static_cast<std::uint32_t>(bytes[at]) << 24 |
         static_cast<std::uint32_t>(bytes[at + 1]) << 16 |
         static_cast<std::uint32_t>(bytes[at + 2]) << 8 | bytes[at + 3];
}

std::uint64_t u64_be(ByteView bytes, std::size_t at) {
  return static_cast<std::uint64_t>(u32_be(bytes, at)) << 32 | u32_be(bytes, at + 4);
}

/// The running checksum of a write-ahead log (section 4.2), its two halves in one number.
class LogChecksum {
 public:
  LogChecksum(std::uint64_t start, bool is_big_endian)
      : first_(static_cast<std::uint32_t>(start >> 32)),
        second_(static_cast<std::uint32_t>(start)),
        is_big_endian_(is_big_endian) {}

  LogChecksum& add(ByteView bytes) {
    for (std::size_t at = 0; at + 8 <= bytes.size(); at += 8) {
      first_ += word(bytes, at) + second_;
      second_ += word(bytes, at + 4) + first_;
    }
    return *this;
  }
  std::uint64_t value() const { return static_cast<std::uint64_t>(first_) << 32 | second_; }

 private:
  std::uint32_t word(ByteView bytes, std::size_t at) const {
    const std::uint32_t big = u32_be(bytes, at);
    return is_big_endian_ ? big : __builtin_bswap32(big);
  }

  std::uint32_t first_;
  std::uint32_t second_;
  bool is_big_endian_;
};

}  // namespace

DatabasePages::DatabasePages(const std::string& path, std::uint32_t page_bytes)
    : page_bytes_(page_bytes),
      database_(path, RawFile::Kind::database),
      log_(path + "-wal", RawFile::Kind::log) {
  add_versions(read_log());
}

/// Each frame is checked against the checksum that the one before it holds, so that damage to one
/// does not hide those after it.
std::vector<DatabasePages::Frame> DatabasePages::read_log() {
  Bytes octets;
  read_all(log_, 0, log_header_bytes, octets);
  const bool is_big_endian = (u32_be(octets, 0) & 1) != 0;
  const std::uint64_t header_checksum =
      LogChecksum(0, is_big_endian).add(ByteView(octets).first(24)).value();
  const bool is_header_good = (u32_be(octets, 0) & ~1U) == log_magic &&
                              u32_be(octets, 8) == page_bytes_ &&
                              header_checksum == u64_be(octets, 24);
  std::optional<std::uint64_t> salts;  // of the frames that belong to the present log
  if (is_header_good) salts = u64_be(octets, 16);
  std::uint64_t seed = header_checksum;

  std::vector<Frame> frames;
  const std::uint64_t frame_bytes = frame_header_bytes + page_bytes_;
  for (std::uint64_t at = log_header_bytes; at + frame_bytes <= log_.size(); at += frame_bytes) {
    read_all(log_, at, frame_bytes, octets);
    const ByteView header = ByteView(octets).first(frame_header_bytes);
    Frame frame{u32_be(header, 0), u32_be(header, 4), u64_be(header, 8), u64_be(header, 16), false};
    const ByteView page = ByteView(octets).subspan(frame_header_bytes);
    frame.is_verified = LogChecksum(seed, is_big_endian).add(header.first(8)).add(page).value() ==
                        frame.stored_checksum;
    if (frame.is_verified && !salts) salts = frame.salts;
    seed = frame.stored_checksum;
    frames.push_back(frame);
  }
  for (Frame& frame : frames) {
    if (frame.salts != salts) frame.page = 0;  // of an earlier log, or its header is damaged
  }
  while (!frames.empty() && frames.back().page == 0) frames.pop_back();
  is_log_damaged_ = (!is_header_good && !frames.empty()) ||
                    std::any_of(frames.begin(), frames.end(), [](const Frame& frame) {
                      return frame.page == 0 || !frame.is_verified;
                    });
  return frames;
}

void DatabasePages::add_versions(const std::vector<Frame>& frames) {
  const std::uint64_t pages_in_file = (database_.size() + page_bytes_ - 1) / page_bytes_;
  std::uint64_t page_limit = pages_in_file + frames.size();
  std::size_t committed = 0;  // frames up to the last commit
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (!frames[i].is_verified || frames[i].pages_after_commit == 0) continue;
    committed = i + 1;
    if (!is_log_damaged_) page_limit = frames[i].pages_after_commit;
  }
  std::unordered_map<std::uint32_t, std::size_t> newest;  // frame of a page
  for (std::size_t i = 0; i < committed; ++i) {
    if (frames[i].page != 0 && frames[i].is_verified) newest[frames[i].page] = i;
  }
  std::vector<Version> others;
  const auto add = [&](const Version& version) {
    if (version.page > page_limit) return;
    if (version.is_current) current_[version.page] = versions_.size();
    (version.is_current ? versions_ : others).push_back(version);
  };
  for (std::uint64_t page = 1; page <= pages_in_file; ++page) {
    const auto number = static_cast<std::uint32_t>(page);
    add({number, (page - 1) * page_bytes_, false, !newest.contains(number)});
  }
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (frames[i].page == 0) continue;
    const auto found = newest.find(frames[i].page);
    const bool is_current = found != newest.end() && found->second == i;
    const std::uint64_t offset =
        log_header_bytes + i * (frame_header_bytes + page_bytes_) + frame_header_bytes;
    add({frames[i].page, offset, true, is_current});
  }
  if (is_log_damaged_) versions_.insert(versions_.end(), others.begin(), others.end());
}

bool DatabasePages::read_all(const RawFile& file, std::uint64_t offset, std::size_t count,
                             Bytes& into) {
  if (file.read(offset, count, into)) return true;
  ++unreadable_;
  Bytes sector;
  for (std::size_t at = 0; at < count; at += sector_bytes) {
    const std::size_t size = std::min(sector_bytes, count - at);
    if (!file.read(offset + at, size, sector)) sector.assign(size, 0);
    std::copy(sector.begin(), sector.end(), into.begin() + static_cast<std::ptrdiff_t>(at));
  }
  return false;
}

bool DatabasePages::read(const Version& version, Bytes& into) {
  return read_all(version.is_in_log ? log_ : database_, version.offset, page_bytes_, into);
}

bool DatabasePages::read(std::uint32_t page, Bytes& into) {
  const auto found = current_.find(page);
  return found != current_.end() && read(versions_[found->second], into);
}

}  // namespace slamgw
