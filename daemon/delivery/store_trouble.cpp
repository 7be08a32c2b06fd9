// SPDX-License-Identifier: Apache-2.0
#include "daemon/delivery/store_trouble.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw {

void StoreTrouble::reset(std::string why) {
  write_ = std::move(why);
  read_.clear();
}

std::optional<Notice> StoreTrouble::on_write_failed(const std::string& why, TimePoint now) {
  return fail(write_, "written: " + why, now);
}

std::optional<Notice> StoreTrouble::on_load_failed(const std::string& why, TimePoint now) {
  return fail(read_, "read: " + why, now);
}

std::optional<Notice> StoreTrouble::fail(std::string& trouble, const std::string& why,
                                         TimePoint now) {
  ++failures_;
  trouble = "it cannot be " + why;
  if (!throttle_.on_event(now)) return std::nullopt;
  return Notice{Severity::error,
                fmt::format("the store cannot be {}; until it can, messages wait in memory and "
                            "robots for the broker's acknowledgement",
                            why),
                {}};
}

std::optional<Notice> StoreTrouble::end(std::string& trouble) {
  if (trouble.empty()) return std::nullopt;
  trouble.clear();
  throttle_ = LogThrottle(interval);  // the next failure is news
  if (!why().empty()) return std::nullopt;
  return Notice{Severity::notice, "the store works again", {}};
}

}  // namespace slamgw
