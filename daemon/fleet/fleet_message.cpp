// SPDX-License-Identifier: Apache-2.0
#include "daemon/fleet/fleet_message.hpp"

#include <fmt/format.h>

#include <charconv>
#include <nlohmann/json.hpp>

#include "daemon/core/result.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::fleet {
namespace {

using Json = nlohmann::json;

constexpr int version = 1;

std::string to_hex64(std::uint64_t number) { return fmt::format("{:016x}", number); }

[[noreturn]] void reject() { throw Json::other_error::create(501, "fleet message", nullptr); }

std::uint64_t hex64(const Json& json) {
  const auto& text = json.get_ref<const std::string&>();
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number, 16);
  if (error != std::errc() || text.empty() || end != text.data() + text.size()) reject();
  return number;
}

Bytes octets(const std::string& hex) {
  if (hex.size() % 2 != 0) reject();
  Bytes read(hex.size() / 2);
  for (std::size_t i = 0; i < read.size(); ++i) {
    const char* pair = hex.data() + 2 * i;
    const auto [end, error] = std::from_chars(pair, pair + 2, read[i], 16);
    if (error != std::errc() || end != pair + 2) reject();
  }
  return read;
}

std::string level(const Json& json) {
  auto text = json.get<std::string>();
  if (!is_valid_level(text)) reject();
  return text;
}

std::string level_or_empty(const Json& json) {
  return json.get_ref<const std::string&>().empty() ? std::string() : level(json);
}

std::uint64_t at_most(const Json& json, std::uint64_t limit) {
  if (!json.is_number_unsigned() || json.get<std::uint64_t>() > limit) reject();
  return json.get<std::uint64_t>();
}

std::int64_t clock_ms(const Json& json) {
  if (!json.is_number_integer()) reject();
  return json.get<std::int64_t>();
}

std::uint64_t epoch(const Json& json) { return at_most(json, max_epoch); }

Json fields(const Beat& beat) {
  return {{"k", "beat"},
          {"sent", beat.sent_ms},
          {"period", beat.period_ms},
          {"count", beat.count},
          {"digest", to_hex64(beat.digest)},
          {"up", beat.up_ms},
          {"gapless", beat.gapless_ms}};
}
Json fields(const ClaimRobot& claim) {
  return {{"k", "claim"}, {"robot", claim.robot}, {"epoch", claim.epoch}, {"from", claim.from}};
}
Json fields(const AskForSign& ask) {
  return {{"k", "sign"}, {"robot", ask.robot}, {"silent", ask.silent_ms}};
}
Json fields(const Heard& heard) { return {{"k", "heard"}, {"robot", heard.robot}}; }
Json fields(const Taken& taken) {
  Json json{{"k", "taken"},         {"id", taken.id},     {"key", to_hex64(taken.key)},
            {"robot", taken.robot}, {"type", taken.type}, {"age", taken.age_ms}};
  if (taken.is_refusal) json["refused"] = true;
  if (taken.is_ended) json["told"] = true;
  if (taken.sent_ms != 0) json["sent"] = taken.sent_ms;
  if (taken.kept_ms != 0) json["kept"] = taken.kept_ms;
  return json;
}
Json fields(const Release& release) {
  Json json{{"k", "release"},
            {"robot", release.robot},
            {"epoch", release.to.epoch},
            {"to", release.to.gateway},
            {"life", to_hex64(release.to.life)}};
  if (!release.session.empty()) json["session"] = to_hex(release.session);
  for (const auto& [id, key, type, age_ms] : release.done)
    json["done"].push_back(Json::array({id, to_hex64(key), type, age_ms}));
  if (release.sent_ms != 0) json["sent"] = release.sent_ms;
  return json;
}
Json fields(const AskTable&) { return {{"k", "ask"}}; }
Json fields(const Table& table) {
  Json rows = Json::array();
  for (const auto& [robot, number] : table.rows) rows.push_back(Json::array({robot, number}));
  return {{"k", "table"}, {"after", table.after}, {"upto", table.upto}, {"rows", std::move(rows)}};
}

Json fields(const Hears& hears) {
  Json rows = Json::array();
  for (const auto& [robot, level_db, age_ms] : hears.rows)
    rows.push_back(Json::array({robot, level_db, age_ms}));
  return {{"k", "hears"}, {"up", hears.is_board_up}, {"rows", std::move(rows)}};
}

Beat read_beat(const Json& json) {
  constexpr std::uint64_t max_period_ms = 60'000;
  Beat beat;
  beat.sent_ms = clock_ms(json.at("sent"));
  beat.period_ms = static_cast<std::uint32_t>(at_most(json.at("period"), max_period_ms));
  beat.count = at_most(json.at("count"), UINT32_MAX);
  beat.digest = hex64(json.at("digest"));
  if (json.contains("up")) beat.up_ms = at_most(json["up"], max_epoch);
  beat.gapless_ms = json.contains("gapless") ? at_most(json["gapless"], max_epoch) : beat.up_ms;
  if (beat.period_ms == 0) reject();
  return beat;
}

Taken read_taken(const Json& json) {
  Taken taken{at_most(json.at("id"), max_epoch),
              hex64(json.at("key")),
              level(json.at("robot")),
              level(json.at("type")),
              0,
              false,
              false};
  if (json.contains("age")) taken.age_ms = at_most(json["age"], max_epoch);
  if (json.contains("refused")) taken.is_refusal = json["refused"].get<bool>();
  if (json.contains("told")) taken.is_ended = json["told"].get<bool>();
  if (json.contains("sent")) taken.sent_ms = clock_ms(json["sent"]);
  if (json.contains("kept")) taken.kept_ms = at_most(json["kept"], max_epoch);
  return taken;
}

std::vector<DoneCommand> read_done(const Json& json) {
  if (!json.is_array() || json.size() > max_taken_commands) reject();
  std::vector<DoneCommand> done;
  for (const Json& row : json)
    done.push_back({at_most(row.at(0), max_epoch), hex64(row.at(1)), level(row.at(2)),
                    at_most(row.at(3), max_epoch)});
  return done;
}

Release read_release(const Json& json) {
  Release release{level(json.at("robot")),
                  {epoch(json.at("epoch")), level(json.at("to")), hex64(json.at("life"))},
                  {}};
  if (json.contains("session"))
    release.session = octets(json["session"].get_ref<const std::string&>());
  if (json.contains("done")) release.done = read_done(json["done"]);
  if (json.contains("sent")) release.sent_ms = clock_ms(json["sent"]);
  return release;
}

Table read_table(const Json& json) {
  Table table{level_or_empty(json.at("after")), level_or_empty(json.at("upto")), {}};
  const Json& rows = json.at("rows");
  if (!rows.is_array() || rows.size() > max_table_rows) reject();
  for (const Json& row : rows) {
    Table::Row next{level(row.at(0)), epoch(row.at(1))};
    const std::string& before = table.rows.empty() ? table.after : table.rows.back().robot;
    if (next.robot <= before || (!table.upto.empty() && next.robot > table.upto)) reject();
    table.rows.push_back(std::move(next));
  }
  return table;
}

Hears read_hears(const Json& json) {
  constexpr int highest_level_db = 100;
  Hears hears{json.at("up").get<bool>(), {}};
  const Json& rows = json.at("rows");
  if (!rows.is_array() || rows.size() > max_table_rows) reject();
  for (const Json& row : rows) {
    if (!row.at(1).is_number_integer()) reject();
    const auto level_db = row.at(1).get<std::int64_t>();
    if (level_db < Hears::lowest_level_db || level_db > highest_level_db) reject();
    hears.rows.push_back(
        {level(row.at(0)), static_cast<int>(level_db), at_most(row.at(2), UINT32_MAX)});
  }
  return hears;
}

Body read_body(const Json& json) {
  const auto& kind = json.at("k").get_ref<const std::string&>();
  if (kind == "beat") return read_beat(json);
  if (kind == "claim")
    return ClaimRobot{level(json.at("robot")), epoch(json.at("epoch")),
                      level_or_empty(json.at("from"))};
  if (kind == "sign")
    return AskForSign{level(json.at("robot")), at_most(json.at("silent"), max_epoch)};
  if (kind == "heard") return Heard{level(json.at("robot"))};
  if (kind == "taken") return read_taken(json);
  if (kind == "release") return read_release(json);
  if (kind == "ask") return AskTable{};
  if (kind == "table") return read_table(json);
  if (kind == "hears") return read_hears(json);
  reject();
}

}  // namespace

std::string encode(Life life, const Body& body) {
  Json json = std::visit([](const auto& what) { return fields(what); }, body);
  json["v"] = version;
  json["b"] = to_hex64(life);
  return json.dump();
}

std::optional<FleetMessage> decode(std::string_view sender, ByteView payload) {
  if (payload.size() > max_payload_octets || !is_valid_level(sender)) return std::nullopt;
  try {
    const Json json = Json::parse(payload.begin(), payload.end());
    if (json.at("v").get<int>() != version) return std::nullopt;
    return FleetMessage{std::string(sender), hex64(json.at("b")), read_body(json)};
  } catch (const Json::exception&) {
    return std::nullopt;
  }
}

}  // namespace slamgw::fleet
