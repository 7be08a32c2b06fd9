// SPDX-License-Identifier: Apache-2.0
#include "web/server/page_session.hpp"

#include <algorithm>

#include "web/server/access.hpp"

namespace slamgw::web {

PageSession::Reaction PageSession::on_text(std::string_view text, TimePoint now) {
  auto message = parse_page_message(text);
  if (const auto* offer = std::get_if<TokenOffer>(&message)) return on_token(*offer);
  if (auto* command = std::get_if<CommandRequest>(&message))
    return on_command(std::move(*command), now);
  return {refusal("", std::get<BadRequest>(message).why)};
}

PageSession::Reaction PageSession::on_token(const TokenOffer& offer) {
  may_send_ = is_same_token(token_, offer.token);
  if (may_send_) return {own_message("token", R"({"accepted":true})")};
  ++wrong_tokens_;
  const char* why = token_.empty()
                        ? R"({"accepted":false,"why":"no token is set: this page only watches"})"
                        : R"({"accepted":false,"why":"this is not the token"})";
  return {own_message("token", why), std::nullopt, wrong_tokens_ >= max_wrong_tokens};
}

PageSession::Reaction PageSession::on_command(CommandRequest command, TimePoint now) {
  if (!may_send_) return {refusal(command.topic, "this page only watches: it has sent no token")};
  if (!topics_.is_command_topic(command.topic))
    return {refusal(command.topic, "no command: only <prefix>/server/<id>/<type> is allowed")};
  if (!take_turn(now)) return {refusal(command.topic, "too many commands at once")};
  return {"", std::move(command)};
}

bool PageSession::take_turn(TimePoint now) {
  const std::chrono::duration<double> passed = now - turns_at_.value_or(now);
  turns_at_ = now;
  turns_ = std::min(command_burst, turns_ + passed.count() * commands_per_second);
  if (turns_ < 1) return false;
  turns_ -= 1;
  return true;
}

std::string refusal(std::string_view topic, std::string_view why) {
  std::string payload = R"({"topic":)";
  append_json_text(payload, topic);
  payload += R"(,"why":)";
  append_json_text(payload, why);
  return own_message("refused", payload + "}");
}

}  // namespace slamgw::web
