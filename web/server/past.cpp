// SPDX-License-Identifier: Apache-2.0
#include "web/server/past.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "daemon/core/bytes.hpp"
#include "daemon/core/normalizer.hpp"
#include "daemon/core/utf8.hpp"
#include "web/server/mirror.hpp"

namespace slamgw::web {
namespace {

using nlohmann::json;

constexpr std::size_t entry_bytes = 64;  // taken by the deque and the shared text

/// Appends x and y; returns false for what the page's decode.js does not draw.
bool append_place(ByteWriter& octets, const json& place) {
  for (const char* key : {"x", "y"}) {
    const auto found = place.find(key);
    if (found == place.end() || !found->is_number()) return false;
    const double value = found->get<double>();
    if (std::abs(value) > 32768.0) return false;
    octets.write_i16_le(static_cast<std::int16_t>(std::min(value, 32767.0)));
  }
  return true;
}

Bytes positions(const json& update) {
  constexpr std::size_t most_obstacles = 4;
  const json obstacles = update.value("obstacles", json::array());
  ByteWriter octets;
  bool is_good = append_place(octets, update) && obstacles.is_array();
  for (std::size_t i = 0; is_good && i < std::min(most_obstacles, obstacles.size()); ++i)
    is_good = append_place(octets, obstacles[i]);
  return is_good ? octets.take() : Bytes();
}

/// Returns the payload's positions without the stray octet; empty when it holds none. Positions of
/// a robot at x = 123 cm begin like JSON.
Bytes positions(std::string_view payload) {
  constexpr std::size_t longest_json = 256;
  if (payload.starts_with('{') && payload.size() <= longest_json)
    if (const json update = json::parse(payload, nullptr, false); update.is_object())
      return positions(update);
  return parse_update(as_bytes(payload)).has_value() ? drop_stray_byte(to_bytes(payload)) : Bytes();
}

}  // namespace

void Past::on_update(std::string_view robot, std::string_view payload, std::int64_t at_ms) {
  const Bytes octets = positions(payload);
  if (octets.empty() || !is_utf8(robot)) return;
  auto known = robots_.find(robot);
  if (known == robots_.end()) {
    constexpr std::int64_t minute = 60'000;  // a flood of names must not cost a search each
    if (robots_.size() >= max_robots && at_ms - searched_ms_ > minute) make_room(at_ms);
    if (robots_.size() >= max_robots) return;
    known = robots_.emplace(std::string(robot), Updates{}).first;
  }
  Update update{at_ms, static_cast<std::uint8_t>(octets.size()), {}};
  std::ranges::copy(octets, update.octets.begin());
  known->second.push_back(update);
  ++count_;
  drop_old(known->second, at_ms);
  if (count_ > max_updates) make_room(at_ms);
}

void Past::drop_old(Updates& updates, std::int64_t now_ms) {
  while (!updates.empty() && updates.front().at_ms < now_ms - length_ms) {
    updates.pop_front();
    --count_;
  }
}

void Past::make_room(std::int64_t now_ms) {
  searched_ms_ = now_ms;
  for (auto& entry : robots_) drop_old(entry.second, now_ms);
  std::erase_if(robots_, [](const auto& entry) { return entry.second.empty(); });
  if (count_ <= max_updates) return;
  const auto most =
      std::ranges::max_element(robots_, {}, [](const auto& entry) { return entry.second.size(); });
  Updates& updates = most->second;
  Updates kept;
  for (std::size_t i = 0; i < updates.size(); ++i)
    if (i >= updates.size() / 2 || i % 2 == 0) kept.push_back(updates[i]);
  count_ -= updates.size() - kept.size();
  updates = std::move(kept);
}

void Past::on_event(SharedText text, std::int64_t at_ms) {
  event_bytes_ += text->size() + entry_bytes;
  events_.push_back({at_ms, std::move(text)});
  while (event_bytes_ > max_event_bytes || events_.front().at_ms < at_ms - length_ms) {
    event_bytes_ -= events_.front().text->size() + entry_bytes;
    events_.pop_front();
  }
}

/// Returns the newer half of the `most` updates without a gap, because they make the trail; of the
/// older updates, each n-th.
std::string Past::text_of(const std::string& robot, const Updates& updates, std::int64_t since_ms,
                          std::size_t most) {
  const auto begin = std::ranges::upper_bound(updates, since_ms, {}, &Update::at_ms);
  const auto size = static_cast<std::size_t>(updates.end() - begin);
  const std::size_t newer = std::min(size, most / 2);
  const std::size_t step =
      std::max<std::size_t>(1, (size - newer) / std::max<std::size_t>(1, most / 2));
  std::string payload = R"({"robot":)";
  append_json_text(payload, robot);
  payload += R"(,"updates":[)";
  for (std::size_t i = 0; i < size; i += i < size - newer ? step : 1) {
    const Update& update = begin[static_cast<std::ptrdiff_t>(i)];
    if (payload.back() != '[') payload += ',';
    payload += '[' + std::to_string(update.at_ms) + ",\"" +
               to_hex(ByteView(update.octets.data(), update.size)) + "\"]";
  }
  return own_message("past", payload + "]}");
}

std::vector<std::pair<std::string, SharedText>> Past::texts(std::int64_t since_ms,
                                                            std::int64_t now_ms) const {
  since_ms = std::max(since_ms, now_ms - length_ms);
  std::vector<std::pair<std::string, SharedText>> all;
  std::string events = R"({"events":[)";
  const auto first = std::ranges::upper_bound(events_, since_ms, {}, &Event::at_ms);
  const auto told = std::min<std::ptrdiff_t>(events_.end() - first, max_told_events);
  for (auto event = events_.end() - told; event != events_.end(); ++event)
    events.append(events.back() == '[' ? "" : ",").append(*event->text);
  all.emplace_back("$web/past",
                   std::make_shared<const std::string>(own_message("past", events + "]}")));
  const std::size_t share =
      std::min(max_told_of_one, max_told / std::max<std::size_t>(1, robots_.size()));
  for (const auto& [robot, updates] : robots_)
    if (!updates.empty() && updates.back().at_ms > since_ms)
      all.emplace_back("$web/past/" + robot, std::make_shared<const std::string>(
                                                 text_of(robot, updates, since_ms, share)));
  return all;
}

}  // namespace slamgw::web
