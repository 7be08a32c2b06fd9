// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/table_record.hpp"

#include <algorithm>

namespace slamgw {
namespace {

constexpr std::size_t file_header_bytes = 100;
constexpr std::size_t leaf_header_bytes = 8;
/// More columns than any table of ours has.
constexpr std::size_t max_values = 32;
/// More than the largest topic and the largest payload of a robot together.
constexpr std::uint64_t max_record_bytes = 256u << 10;

std::size_t u16_be(ByteView bytes, std::size_t at) {
  return static_cast<std::size_t>(bytes[at]) << 8 | bytes[at + 1];
}

/// Up to nine octets, the highest first. False when they end early.
bool read_varint(ByteView bytes, std::size_t& at, std::uint64_t& value) {
  value = 0;
  for (int i = 0; i < 9; ++i) {
    if (at >= bytes.size()) return false;
    const std::uint8_t octet = bytes[at++];
    if (i == 8) {
      value = value << 8 | octet;
      return true;
    }
    value = value << 7 | (octet & 0x7f);
    if ((octet & 0x80) == 0) return true;
  }
  return true;
}

std::int64_t read_integer(ByteView bytes) {
  std::uint64_t value = !bytes.empty() && (bytes[0] & 0x80) != 0 ? ~std::uint64_t{0} : 0;
  for (const std::uint8_t octet : bytes) value = value << 8 | octet;
  return static_cast<std::int64_t>(value);
}

/// Section 2.1: what a serial type stands for, and how many octets it takes.
struct SerialType {
  RecordValue::Kind kind;
  std::uint64_t size;
};
std::optional<SerialType> serial_type(std::uint64_t type) {
  using Kind = RecordValue::Kind;
  if (type == 0) return SerialType{Kind::null, 0};
  if (type <= 4) return SerialType{Kind::integer, type};
  if (type == 5) return SerialType{Kind::integer, 6};
  if (type == 6) return SerialType{Kind::integer, 8};
  if (type == 7) return SerialType{Kind::real, 8};
  if (type == 8 || type == 9) return SerialType{Kind::integer, 0};
  if (type < 12) return std::nullopt;
  return SerialType{type % 2 == 0 ? Kind::blob : Kind::text, (type - 12) / 2};
}

bool read_values(ByteView content, std::vector<RecordValue>& values) {
  std::size_t at = 0;
  std::uint64_t header_size = 0;
  if (!read_varint(content, at, header_size) || header_size > content.size()) return false;
  const ByteView header = content.first(static_cast<std::size_t>(header_size));
  auto body = static_cast<std::size_t>(header_size);
  while (at < header.size()) {
    std::uint64_t type = 0;
    if (values.size() == max_values || !read_varint(header, at, type)) return false;
    const auto meaning = serial_type(type);
    if (!meaning || meaning->size > content.size() - body) return false;
    const ByteView bytes = content.subspan(body, static_cast<std::size_t>(meaning->size));
    body += bytes.size();
    RecordValue value{meaning->kind, 0, {}};
    if (meaning->kind == RecordValue::Kind::integer) {
      value.number = type == 8 ? 0 : type == 9 ? 1 : read_integer(bytes);
    } else {
      value.bytes = bytes;
    }
    values.push_back(value);
  }
  return body == content.size();
}

/// Appends what lies in the chain of overflow pages from `next` on, until there are `size` octets.
bool append_overflow(DatabasePages& pages, std::uint32_t next, std::uint64_t size, Bytes& buffer) {
  Bytes page;
  while (buffer.size() < size) {
    if (next == 0 || !pages.read(next, page)) return false;
    next = static_cast<std::uint32_t>(u16_be(page, 0) << 16 | u16_be(page, 2));
    const std::size_t missing = static_cast<std::size_t>(size) - buffer.size();
    const std::size_t here = std::min(missing, page.size() - 4);
    buffer.insert(buffer.end(), page.begin() + 4,
                  page.begin() + 4 + static_cast<std::ptrdiff_t>(here));
  }
  return true;
}

}  // namespace

std::vector<std::size_t> cells_of(ByteView page, std::uint32_t page_number) {
  const std::size_t header = page_number == 1 ? file_header_bytes : 0;
  // Overflow pages hold what robots wrote, and begin with the high octet of a page number, which is
  // zero. A first octet that is wrong for a leaf may be one that was damaged.
  if (page[header] == 0) return {};
  const std::size_t room = (page.size() - header - leaf_header_bytes) / 2;
  const std::size_t count = std::min(u16_be(page, header + 3), room);
  std::vector<std::size_t> cells;
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t cell = u16_be(page, header + leaf_header_bytes + 2 * i);
    if (cell > header && cell < page.size()) cells.push_back(cell);
  }
  return cells;
}

std::optional<TableRecord> read_record(DatabasePages& pages, ByteView page, std::size_t cell,
                                       Bytes& buffer) {
  TableRecord record;
  std::uint64_t size = 0;
  std::uint64_t row = 0;
  std::size_t at = cell;
  if (!read_varint(page, at, size) || !read_varint(page, at, row)) return std::nullopt;
  record.row = static_cast<std::int64_t>(row);
  // Section 1.6: how much of a record is in the leaf itself.
  const std::uint64_t usable = page.size();
  const std::uint64_t most = usable - 35;
  const std::uint64_t least = (usable - 12) * 32 / 255 - 23;
  std::uint64_t local = size;
  if (size > most) {
    local = least + (size - least) % (usable - 4);
    if (local > most) local = least;
  }
  const std::uint64_t end = at + local + (local < size ? 4 : 0);
  if (end > page.size() || size > max_record_bytes) return std::nullopt;
  const ByteView here = page.subspan(at, static_cast<std::size_t>(local));
  buffer.assign(here.begin(), here.end());
  if (local < size) {
    at += here.size();
    const auto next = static_cast<std::uint32_t>(u16_be(page, at) << 16 | u16_be(page, at + 2));
    if (!append_overflow(pages, next, size, buffer)) return std::nullopt;
  }
  if (!read_values(buffer, record.values)) return std::nullopt;
  return record;
}

void for_each_record(
    DatabasePages& pages,
    const std::function<void(std::uint32_t, std::uint32_t, const TableRecord&)>& take) {
  Bytes page;
  Bytes buffer;
  for (std::uint32_t version = 0; version < pages.versions().size(); ++version) {
    pages.read(pages.versions()[version], page);
    for (const std::size_t cell : cells_of(page, pages.versions()[version].page)) {
      const auto record = read_record(pages, page, cell, buffer);
      if (record) take(version, static_cast<std::uint32_t>(cell), *record);
    }
  }
}

std::string shape_of(const TableRecord& record) {
  std::string shape;
  for (const RecordValue& value : record.values) {
    switch (value.kind) {
      case RecordValue::Kind::null: shape += '0'; break;
      case RecordValue::Kind::integer: shape += 'i'; break;
      case RecordValue::Kind::real: shape += 'r'; break;
      case RecordValue::Kind::text: shape += 't'; break;
      case RecordValue::Kind::blob: shape += 'b'; break;
    }
  }
  return shape;
}

}  // namespace slamgw
