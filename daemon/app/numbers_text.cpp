// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/numbers_text.hpp"

#include <fmt/compile.h>
#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <iterator>
#include <optional>
#include <vector>

#include "daemon/core/announcements.hpp"
#include "daemon/core/utf8.hpp"

namespace slamgw {
namespace {

using Row = std::map<std::string, Robot>::value_type;
constexpr std::size_t usual_row_octets = 256;

/// Returns all robots, or the max_robots_in_numbers that were heard last.
std::vector<const Row*> choose(const std::map<std::string, Robot>& robots) {
  std::vector<const Row*> rows;
  rows.reserve(robots.size());
  for (const Row& robot : robots) rows.push_back(&robot);
  if (rows.size() <= max_robots_in_numbers) return rows;
  constexpr auto end = static_cast<std::ptrdiff_t>(max_robots_in_numbers);
  std::ranges::nth_element(rows, rows.begin() + end, std::ranges::greater(),
                           [](const Row* row) { return row->second.last_seen; });
  rows.resize(max_robots_in_numbers);
  return rows;
}

template <class Number>
std::string or_null(const std::optional<Number>& number) {
  return number ? fmt::to_string(*number) : "null";
}

/// Appends the numbers of each mesh that the robot was on.
void append_meshes(const Robot& robot, fmt::memory_buffer& text) {
  text.append(std::string_view(R"(,"meshes":{)"));
  const std::size_t begin = text.size();
  for (const Mesh mesh : all_meshes) {
    const MeshPresence& there = robot.on_mesh[mesh];
    if (!there.was_used()) continue;
    if (text.size() > begin) text.push_back(',');
    fmt::format_to(std::back_inserter(text),
                   FMT_COMPILE(R"("{}":{{"up":{},"down":{},"repeats":{}}})"), to_string(mesh),
                   there.up, there.down, there.repeats);
  }
  text.append(std::string_view("}}"));
}

void append(const Row& row, TimePoint now, fmt::memory_buffer& text) {
  const auto& [id, robot] = row;
  std::optional<std::int64_t> p50, p99;
  if (const auto latency = robot.numbers.latency(now)) {
    p50 = latency->p50.count();
    p99 = latency->p99.count();
  }
  const RadioFacts radio = robot.radio_now();
  const auto hundredths = static_cast<unsigned>(robot.numbers.rate_hz(now) * 100 + 0.5);
  fmt::format_to(
      std::back_inserter(text),
      FMT_COMPILE(R"({}:{{"up":{},"down":{},"repeats":{},"gaps":{},"rate_hz":{}.{:02},)"
                  R"("latency_p50_us":{},"latency_p99_us":{},"rssi_dbm":{},"hops":{},"ttl":{},)"
                  R"("last_heard":"{}","mesh":"{}")"),
      escape_unprintable(json_string(id)), robot.numbers.up(), robot.numbers.down(),
      robot.numbers.repeats(), robot.numbers.gaps(), hundredths / 100, hundredths % 100,
      or_null(p50), or_null(p99), or_null(radio.rssi_dbm), or_null(radio.hops), or_null(radio.ttl),
      to_iso8601(robot.last_seen), to_string(robot.mesh()));
  append_meshes(robot, text);
}

}  // namespace

/// Formatted directly, without a tree of JSON values: this runs for a thousand robots every 10 s.
Bytes numbers_text(const std::map<std::string, Robot>& robots, TimePoint now) {
  const std::vector<const Row*> rows = choose(robots);
  const std::size_t left_out = robots.size() - rows.size();
  fmt::memory_buffer text;
  text.reserve(rows.size() * usual_row_octets);
  text.append(std::string_view(R"({"robots":{)"));
  for (const Row* row : rows) {
    if (row != rows.front()) text.push_back(',');
    append(*row, now, text);
  }
  text.push_back('}');
  if (left_out > 0)
    fmt::format_to(std::back_inserter(text), FMT_COMPILE(R"(,"left_out":{})"), left_out);
  text.push_back('}');
  return to_bytes({text.data(), text.size()});
}

}  // namespace slamgw
