// SPDX-License-Identifier: Apache-2.0
// The distance of a misspelt word from a known one, for "did you mean ...?".
#pragma once

#include <algorithm>
#include <string_view>
#include <utility>
#include <vector>

namespace slamgw {

/// Levenshtein's distance: insertions, deletions and replacements. Takes time in proportion to the
/// product of the lengths; callers bound these.
inline std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t changed = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({changed, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row.back();
}

}  // namespace slamgw
