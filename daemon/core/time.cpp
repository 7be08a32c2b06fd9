// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/time.hpp"

#include <fmt/compile.h>
#include <fmt/format.h>

namespace slamgw {
namespace {

/// `YYYY-MM-DDThh:mm:ss`. The formatting of times by libraries takes several times as long, and
/// this runs for each presence, for many messages, and for each robot every 10 s.
std::string to_the_second(WallTime time) {
  const auto day = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss clock(std::chrono::floor<std::chrono::seconds>(time - day));
  return fmt::format(FMT_COMPILE("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}"),
                     static_cast<int>(date.year()), static_cast<unsigned>(date.month()),
                     static_cast<unsigned>(date.day()), clock.hours().count(),
                     clock.minutes().count(), clock.seconds().count());
}

/// The part of `time` beyond its whole second.
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
