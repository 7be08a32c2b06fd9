// SPDX-License-Identifier: Apache-2.0
// Feeds any octets as a page's message, and as topic and payload of the broker. Texts for pages
// must be JSON.
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <string>

#include "web/server/access.hpp"
#include "web/server/page_session.hpp"

namespace {
void require(bool holds) {
  if (!holds) std::abort();
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace slamgw::web;
  const std::string input(reinterpret_cast<const char*>(data), size);
  static const Topics topics("p");
  static const Tokens tokens = std::get<Tokens>(Tokens::parse("0123456789abcdef"));
  TokenGuesses guesses;
  PageSession session(topics, tokens, guesses, {"192.0.2.1"});
  session.on_text(R"({"topic":"$web/token","payload":"0123456789abcdef"})", {});
  const PageSession::Reaction reaction = session.on_text(input, {});
  if (!reaction.reply.empty()) require(nlohmann::json::accept(reaction.reply));
  if (reaction.publish) require(topics.may_publish(reaction.publish->topic));

  const std::size_t split = input.find('\n');
  const std::string topic = "p/" + input.substr(0, split);
  const std::string payload = split == input.npos ? "" : input.substr(split + 1);
  const auto text = to_page({topic, payload, 0, false, payload, "", ""}, topics.kind_of(topic));
  if (text) require(nlohmann::json::accept(*text));
  AccessRules({"host"}).is_own_host(input);
  return 0;
}
