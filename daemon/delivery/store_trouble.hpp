// SPDX-License-Identifier: Apache-2.0
// Why the store cannot be written or read, and what the log says about it: a failure once a minute,
// its end once. Pure; part of the outbox.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "daemon/core/log_throttle.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw {

class StoreTrouble {
 public:
  /// Empty while the store can be written and read.
  const std::string& why() const { return write_.empty() ? read_ : write_; }
  std::uint64_t failures() const { return failures_; }

  std::optional<Notice> on_write_failed(const std::string& why, TimePoint now);
  std::optional<Notice> on_load_failed(const std::string& why, TimePoint now);
  std::optional<Notice> on_written() { return end(write_); }
  std::optional<Notice> on_loaded() { return end(read_); }
  /// Another store, or none for the reason `why`.
  void reset(std::string why = {});

 private:
  static constexpr std::chrono::minutes interval{1};

  std::optional<Notice> fail(std::string& trouble, const std::string& why, TimePoint now);
  std::optional<Notice> end(std::string& trouble);

  std::string write_;
  std::string read_;
  std::uint64_t failures_ = 0;
  LogThrottle throttle_{interval};
};

}  // namespace slamgw
