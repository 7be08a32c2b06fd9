// SPDX-License-Identifier: Apache-2.0
#include "daemon/core/normalizer.hpp"

#include <fmt/format.h>

#include <iterator>
#include <utility>

namespace slamgw {

namespace {

constexpr std::size_t pair_bytes = 4;
constexpr std::size_t max_obstacles = 4;

Position read_position(ByteReader& reader) {
  const std::int16_t x = reader.read_i16_le();
  const std::int16_t y = reader.read_i16_le();
  return {x, y};
}

}  // namespace

std::optional<Update> parse_update(ByteView payload) {
  const std::size_t pairs = payload.size() / pair_bytes;
  const std::size_t stray_bytes = payload.size() % pair_bytes;
  if (pairs < 1 || pairs > 1 + max_obstacles || stray_bytes > 1) return std::nullopt;

  ByteReader reader(payload);
  Update update{read_position(reader), {}};
  update.obstacles.reserve(pairs - 1);
  while (update.obstacles.size() + 1 < pairs) update.obstacles.push_back(read_position(reader));
  return update;
}

Bytes drop_stray_byte(Bytes payload) {
  payload.resize(payload.size() - payload.size() % pair_bytes);
  return payload;
}

std::string encode_json(const Update& update) {
  std::string json;
  auto out = std::back_inserter(json);
  fmt::format_to(out, R"({{"x":{},"y":{},"obstacles":[)", update.robot.x_cm, update.robot.y_cm);
  std::string_view separator;
  for (const Position& obstacle : update.obstacles) {
    fmt::format_to(out, R"({}{{"x":{},"y":{}}})", separator, obstacle.x_cm, obstacle.y_cm);
    separator = ",";
  }
  return json + "]}";
}

namespace {

constexpr std::string_view update_type = "update";

Bytes encode(const Update& update, UpdateMode mode, Bytes as_it_came) {
  switch (mode) {
    case UpdateMode::positions: return drop_stray_byte(std::move(as_it_came));
    case UpdateMode::json: return to_bytes(encode_json(update));
    case UpdateMode::raw: return as_it_came;
  }
  return as_it_came;
}

}  // namespace

Normalized normalize(std::string_view type, Bytes payload, UpdateMode mode) {
  if (type != update_type) return {std::move(payload), std::nullopt, false, false};
  auto update = parse_update(payload);
  if (!update) {
    const bool is_rejected = mode != UpdateMode::raw;  // raw reads nothing, so it refuses nothing
    return {std::move(payload), std::nullopt, false, is_rejected};
  }
  const bool had_stray_octet = payload.size() % pair_bytes != 0;
  Bytes encoded = encode(*update, mode, std::move(payload));
  return {std::move(encoded), std::move(*update), had_stray_octet, false};
}

}  // namespace slamgw
