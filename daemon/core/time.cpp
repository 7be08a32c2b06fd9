// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/time.hpp"

#include <fmt/format.h>

namespace slamgw {
namespace {

/// `YYYY-MM-DDThh:mm:ss`, written for each presence and many messages: fmt's own formats of times
/// take a multiple.
std::string to_the_second(WallTime time) {
  const auto day = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss clock(std::chrono::floor<std::chrono::seconds>(time - day));
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}", static_cast<int>(date.year()),
                     static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day()),
                     clock.hours().count(), clock.minutes().count(), clock.seconds().count());
}

/// What `time` has beyond its whole second.
template <class Unit>
auto fraction(WallTime time) {
  const auto second = std::chrono::floor<std::chrono::seconds>(time);
  return std::chrono::duration_cast<Unit>(time - second).count();
}

}  // namespace

std::string to_iso8601(WallTime time) { return to_the_second(time) + "Z"; }

std::string to_iso8601_ms(WallTime time) {
  return fmt::format("{}.{:03}Z", to_the_second(time), fraction<std::chrono::milliseconds>(time));
}

std::string to_iso8601_us(WallTime time) {
  return fmt::format("{}.{:06}Z", to_the_second(time), fraction<std::chrono::microseconds>(time));
}

}  // namespace slamgw
