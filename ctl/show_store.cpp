// SPDX-License-Identifier: Apache-2.0
// What slam-gatewayctl shows of dead letters.
#include <fmt/format.h>

#include "ctl/show.hpp"
#include "ctl/text.hpp"

namespace slamgw::ctl::show {

using nlohmann::json;

std::string dead_letters_head(const json& first_page) {
  const std::uint64_t count = count_at(first_page, "count");
  if (count == 0) return "no dead letters\n";
  if (first_page.at("letters").empty())
    return fmt::format("no dead letters of this topic; of others: {}\n", count);
  return fmt::format("{} dead letters, {}\n{:>8} {:>4} {:>6} {:>5} TOPIC: REASON\n", count,
                     show_bytes(count_at(first_page, "bytes")), "ID", "AGE", "BYTES", "TRIES");
}

std::string dead_letters(const json& letters, const Screen& screen) {
  std::string out;
  for (const json& letter : letters) {
    out +=
        fmt::format("{:>8} {:>4} {:>6} {:>5} {}: {}\n", count_at(letter, "id"),
                    show_age(text_at(letter, "stored_at"), screen.now), count_at(letter, "bytes"),
                    count_at(letter, "tries"), text_at(letter, "topic"), text_at(letter, "reason"));
  }
  return out;
}

std::string resent(const json& done) {
  const std::uint64_t left = count_at(done, "left");
  std::string out = fmt::format("{} dead letters are sent again\n", count_at(done, "resent"));
  if (left > 0) {
    out += fmt::format(
        "{} stay: the store is full or fails (slam-gatewayctl status), or they are damaged\n",
        left);
  }
  return out;
}

std::string discarded(const json& done) {
  return fmt::format("{} dead letters were discarded\n", count_at(done, "discarded"));
}

}  // namespace slamgw::ctl::show
