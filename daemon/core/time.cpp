// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/time.hpp"

#include <fmt/format.h>

namespace slamgw {
namespace {

/// The last `digits` digits of `number`, up to `end`.
void write_digits(char* end, int digits, unsigned number) {
  for (; digits > 0; --digits, number /= 10) *--end = static_cast<char>('0' + number % 10);
}

/// `YYYY-MM-DDThh:mm:ss`. Formatting libraries take several times as long, and this runs for each
/// presence, for many messages, and for each robot every 10 s.
std::string to_the_second(WallTime time) {
  const auto day = std::chrono::floor<std::chrono::days>(time);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss clock(std::chrono::floor<std::chrono::seconds>(time - day));
  std::string text = "YYYY-MM-DDThh:mm:ss";
  const auto write = [&text](std::size_t end, int digits, auto number) {
    write_digits(text.data() + end, digits, static_cast<unsigned>(number));
  };
  write(4, 4, static_cast<int>(date.year()));
  write(7, 2, static_cast<unsigned>(date.month()));
  write(10, 2, static_cast<unsigned>(date.day()));
  write(13, 2, clock.hours().count());
  write(16, 2, clock.minutes().count());
  write(19, 2, clock.seconds().count());
  return text;
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
