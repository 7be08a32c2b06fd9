// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/time.hpp"

#include <cstdint>

namespace slamgw {
namespace {

/// Adds the digits of `value` to the zeros of `out` that stand before `end`, a zero for each digit.
void write(std::string& out, std::size_t end, std::int64_t value) {
  for (; value > 0; value /= 10) out[--end] += static_cast<char>(value % 10);
}

/// Fills in `0000-00-00T00:00:00`, with which `out` begins. Libraries take many times as long, and
/// this runs for each presence, for most messages, and for each robot every 10 s.
std::string to_the_second(WallTime time, std::string out) {
  const auto day = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss clock(std::chrono::floor<std::chrono::seconds>(time - day));
  write(out, 4, static_cast<int>(date.year()));
  write(out, 7, static_cast<unsigned>(date.month()));
  write(out, 10, static_cast<unsigned>(date.day()));
  write(out, 13, clock.hours().count());
  write(out, 16, clock.minutes().count());
  write(out, 19, clock.seconds().count());
  return out;
}

/// The part of `time` beyond its whole second.
template <class Unit>
auto fraction(WallTime time) {
  const auto second = std::chrono::floor<std::chrono::seconds>(time);
  return std::chrono::duration_cast<Unit>(time - second).count();
}

}  // namespace

std::string to_iso8601(WallTime time) { return to_the_second(time, "0000-00-00T00:00:00Z"); }

std::string to_iso8601_ms(WallTime time) {
  std::string out = to_the_second(time, "0000-00-00T00:00:00.000Z");
  write(out, out.size() - 1, fraction<std::chrono::milliseconds>(time));
  return out;
}

std::string to_iso8601_us(WallTime time) {
  std::string out = to_the_second(time, "0000-00-00T00:00:00.000000Z");
  write(out, out.size() - 1, fraction<std::chrono::microseconds>(time));
  return out;
}

}  // namespace slamgw
