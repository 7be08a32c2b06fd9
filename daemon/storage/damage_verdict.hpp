// SPDX-License-Identifier: Apache-2.0
// Decides whether a file that cannot be used is damaged, or its disk only fails for a moment
// (SQLite calls both "malformed"). Pure; asked by the stores after each check of the file. Also how
// long they wait for a disk.
#pragma once

#include <optional>

#include "daemon/core/time.hpp"

namespace slamgw {

/// How long the stores wait for a disk.
struct StorePatience {
  /// Between attempts to open a file that could not be opened.
  std::chrono::milliseconds reopen{10000};
  /// Between checks of a file that seems damaged or cannot be read.
  std::chrono::milliseconds check{1000};
  /// How long such checks may hold up the start before the daemon continues without the store.
  std::chrono::milliseconds opening{10000};
  /// Parts of the file that the disk could not read for so long are lost.
  std::chrono::milliseconds unreadable{60000};
  /// How long the outbox may take to keep a page of dead letters that are sent again.
  std::chrono::milliseconds resend{10000};
};

class DamageVerdict {
 public:
  /// A file counts as damaged when it was unusable so many times in a row and all of it could be
  /// read.
  static constexpr int checks_needed = 3;

  /// `unreadable_patience`: parts that could not be read for so long are lost.
  explicit DamageVerdict(Duration unreadable_patience)
      : unreadable_patience_(unreadable_patience) {}

  /// The disk failed to read something.
  void on_read_error(TimePoint now) {
    if (!failing_since_) failing_since_ = now;
  }
  /// It has failed for so long that the whole file is to be checked.
  bool is_persistent(TimePoint now) const {
    return failing_since_ && now - *failing_since_ >= unreadable_patience_;
  }
  /// The file was found unusable, and `unreadable` of its parts could not be read. True when what
  /// is left of it is to be saved.
  bool is_damaged(std::size_t unreadable, TimePoint now) {
    if (unreadable == 0) return ++failed_checks_ >= checks_needed;
    failed_checks_ = 0;
    on_read_error(now);
    return is_persistent(now);
  }
  /// The file can be used.
  void reset() {
    failed_checks_ = 0;
    failing_since_.reset();
  }

 private:
  Duration unreadable_patience_;
  int failed_checks_ = 0;
  std::optional<TimePoint> failing_since_;
};

}  // namespace slamgw
