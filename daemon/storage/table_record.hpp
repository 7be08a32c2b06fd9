// SPDX-License-Identifier: Apache-2.0
// Rows in the pages of a SQLite table, read without SQLite
// (https://www.sqlite.org/fileformat2.html, sections 1.6 and 2.1). Trusts nothing that it reads:
// what comes of damaged pages may be anything, and a checksum must say what is good.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "daemon/storage/database_pages.hpp"

namespace slamgw {

struct RecordValue {
  enum class Kind : std::uint8_t { null, integer, real, text, blob };
  Kind kind = Kind::null;
  std::int64_t number = 0;  ///< of an integer
  ByteView bytes;           ///< of a text or a blob
};

struct TableRecord {
  std::int64_t row = 0;
  std::vector<RecordValue> values;  ///< views into the buffer that it was read with
};

/// Where the cells of `page` begin, as far as that can be true. `page_number` 1 begins with the
/// file's header. Nothing for pages that can't be leaves of a table.
std::vector<std::size_t> cells_of(ByteView page, std::uint32_t page_number);

/// The record in the cell at `cell`, with what of it lies in overflow pages. `buffer` holds the
/// values and must outlive them. Nothing when it is none.
std::optional<TableRecord> read_record(DatabasePages& pages, ByteView page, std::size_t cell,
                                       Bytes& buffer);

}  // namespace slamgw
