// SPDX-License-Identifier: Apache-2.0
// Rows in the pages of a SQLite table, read without SQLite
// (https://www.sqlite.org/fileformat2.html, sections 1.6 and 2.1). Trusts nothing that it reads:
// what comes of damaged pages may be anything, and a checksum must say what is good.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
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

/// Every record that can be found in any version of any page. `version` is an index in
/// pages.versions(), `cell` as for read_record(). The record is gone when `take` returns.
void for_each_record(DatabasePages& pages,
                     const std::function<void(std::uint32_t version, std::uint32_t cell,
                                              const TableRecord& record)>& take);

/// What the columns of a record hold, a letter for each: t text, b blob, i integer, r real,
/// 0 NULL, which stands for the number of the row.
std::string shape_of(const TableRecord& record);

}  // namespace slamgw
