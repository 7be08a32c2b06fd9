// SPDX-License-Identifier: Apache-2.0
#include "web/server/history.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <utility>

#include "web/server/mirror.hpp"
#include "web/server/roster.hpp"

namespace slamgw::web {
namespace {

using nlohmann::json;

std::optional<std::int64_t> number(const json& numbers, const char* key) {
  const auto found = numbers.find(key);
  if (found == numbers.end() || !found->is_number_integer()) return std::nullopt;
  return found->get<std::int64_t>();
}

template <class Small>
Small clamped(std::int64_t value) {
  return static_cast<Small>(std::clamp<std::int64_t>(value, std::numeric_limits<Small>::min(),
                                                     std::numeric_limits<Small>::max()));
}

/// Adds the increase since the last report to `in_slot`. A restarted gateway counts from 0.
void count(std::uint16_t& in_slot, std::optional<std::uint64_t>& before,
           std::optional<std::int64_t> now) {
  if (!now || *now < 0) return;
  const auto total = static_cast<std::uint64_t>(*now);
  const std::uint64_t added = before && total >= *before ? total - *before : 0;
  in_slot = clamped<std::uint16_t>(in_slot + clamped<std::uint16_t>(static_cast<int64_t>(added)));
  before = total;
}

/// Returns whether the slot can only be from before the clock was set back.
bool is_ahead(std::int64_t number, std::int64_t now_ms) {
  return number > now_ms / History::slot_ms + 1;
}

/// The slot's place in the ring. `number`: the slot's, counted from 1970.
std::size_t place_of(std::int64_t number) {
  return static_cast<std::size_t>(number) % History::slots;
}

}  // namespace

History::Day* History::day_of(std::string_view robot, std::int64_t now_ms) {
  auto found = days_.find(robot);
  if (found == days_.end()) {
    if (days_.size() >= max_robots) return nullptr;
    found = days_.emplace(std::string(robot), Day{}).first;
    found->second.newest = found->second.oldest = now_ms / slot_ms;
  }
  return &found->second;
}

History::Slot& History::slot_at(Day& day, std::int64_t now_ms) {
  if (is_ahead(day.newest, now_ms)) {
    day.ring = {};
    day.newest = day.oldest = now_ms / slot_ms;
    day.alive_ms = std::min(day.alive_ms, now_ms);
  }
  const std::int64_t number = std::max(day.newest, now_ms / slot_ms);
  const std::int64_t first =
      std::max(day.newest + 1, number - static_cast<std::int64_t>(slots) + 1);
  for (std::int64_t each = first; each <= number; ++each) day.ring[place_of(each)] = {};
  day.newest = number;
  day.oldest = std::max(day.oldest, number - static_cast<std::int64_t>(slots) + 1);
  return day.ring[place_of(number)];
}

void History::on_numbers(const Roster& roster, std::string_view gateway, std::string_view payload,
                         std::int64_t now_ms) {
  const json document = json::parse(payload, nullptr, false);
  const auto robots = document.is_object() ? document.find("robots") : document.end();
  if (robots == document.end() || !robots->is_object()) return;
  for (const auto& [id, numbers] : robots->items()) {
    if (!numbers.is_object() || roster.robot(id).gateway != gateway) continue;
    Day* const day = day_of(id, now_ms);
    if (day == nullptr) continue;
    if (day->gateway != gateway) {
      day->gateway = gateway;
      day->repeats = day->gaps = std::nullopt;
    }
    Slot& slot = slot_at(*day, now_ms);
    if (const auto rssi = number(numbers, "rssi_dbm")) slot.rssi_dbm = clamped<std::int8_t>(*rssi);
    if (const auto latency = number(numbers, "latency_p50_us"))
      slot.latency_us = clamped<std::uint32_t>(*latency);
    count(slot.repeats, day->repeats, number(numbers, "repeats"));
    count(slot.gaps, day->gaps, number(numbers, "gaps"));
  }
}

void History::update(const Roster& roster, std::int64_t now_ms) {
  if (std::abs(now_ms - sampled_ms_) < sample_ms) return;
  sampled_ms_ = now_ms;
  constexpr std::int64_t day_ms = slot_ms * static_cast<std::int64_t>(slots);
  roster.each_robot([&](const std::string& id, const RobotLife& life) {
    if (now_ms - life.heard_ms > day_ms && !days_.contains(id)) return;
    Day* const day = day_of(id, now_ms);
    if (day == nullptr) return;
    Slot& slot = slot_at(*day, now_ms);
    if (life.state == "unknown" || slot.known == std::numeric_limits<std::uint8_t>::max()) return;
    ++slot.known;
    if (life.state != "offline") {
      ++slot.online;
      day->alive_ms = now_ms;
    }
  });
  std::erase_if(days_, [&](const auto& entry) {
    const Day& day = entry.second;
    return is_ahead(day.oldest, now_ms) ||
           (day.oldest < (now_ms - day_ms) / slot_ms + 1 && now_ms - day.alive_ms > day_ms);
  });
}

std::string History::text(std::string_view robot, std::int64_t now_ms) const {
  const auto found = days_.find(robot);
  Day day = found == days_.end() ? Day{} : found->second;
  if (found == days_.end()) day.oldest = day.newest = now_ms / slot_ms;
  slot_at(day, now_ms);
  std::string out = R"({"robot":)";
  append_json_text(out, robot);
  fmt::format_to(std::back_inserter(out), R"(,"from":{},"slot_ms":{})", day.oldest * slot_ms,
                 slot_ms);
  const auto row = [&](std::string_view name, auto&& value_of) {
    fmt::format_to(std::back_inserter(out), R"(,"{}":[)", name);
    for (std::int64_t each = day.oldest; each <= day.newest; ++each) {
      const std::optional<std::int64_t> value = value_of(day.ring[place_of(each)]);
      fmt::format_to(std::back_inserter(out), "{}{}", each == day.oldest ? "" : ",",
                     value ? fmt::to_string(*value) : "null");
    }
    out += ']';
  };
  using Value = std::optional<std::int64_t>;
  row("online", [](const Slot& s) { return s.known ? Value(100 * s.online / s.known) : Value(); });
  row("rssi_dbm", [](const Slot& s) { return s.rssi_dbm ? Value(s.rssi_dbm) : Value(); });
  row("latency_us", [](const Slot& s) { return s.latency_us ? Value(s.latency_us) : Value(); });
  row("repeats", [](const Slot& s) { return s.known ? Value(s.repeats) : Value(); });
  row("gaps", [](const Slot& s) { return s.known ? Value(s.gaps) : Value(); });
  return out + "}";
}

}  // namespace slamgw::web
