// SPDX-License-Identifier: Apache-2.0
#include "web/server/page_session.hpp"

#include <nlohmann/json.hpp>

namespace slamgw::web {
namespace {

std::string dumped(const nlohmann::json& document) {
  return document.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

PageSession::Reaction PageSession::on_text(std::string_view text, TimePoint now) {
  auto message = parse_page_message(text);
  if (const auto* offer = std::get_if<TokenOffer>(&message)) return on_token(*offer, now);
  if (auto* command = std::get_if<CommandRequest>(&message))
    return on_command(std::move(*command), now);
  if (auto* request = std::get_if<HistoryRequest>(&message))
    return on_history(std::move(*request), now);
  if (const auto* request = std::get_if<PastRequest>(&message)) {
    Reaction reaction;
    if (may_watch() && !std::exchange(has_past_, true)) reaction.past_since_ms = request->since_ms;
    return reaction;
  }
  return {refusal("", std::get<BadRequest>(message).why)};
}

PageSession::Reaction PageSession::on_token(const TokenOffer& offer, TimePoint now) {
  holder_ = tokens_.find(offer.token);
  if (!holder_) return on_wrong_token(now);
  guesses_.forget(client_);
  answer_due_ = now;
  nlohmann::json payload{
      {"accepted", true}, {"name", holder_->name}, {"role", to_string(holder_->role)}};
  if (holder_->role == Role::operator_ && !tokens_.note().empty()) payload["note"] = tokens_.note();
  Reaction reaction{own_message("token", dumped(payload))};
  reaction.drops_delayed_reply = true;
  return reaction;
}

PageSession::Reaction PageSession::on_wrong_token(TimePoint now) {
  Reaction reaction;
  reaction.ends = ++wrong_tokens_ >= max_wrong_tokens;
  if (tokens_.empty()) {  // there is nothing to guess
    constexpr const char* why =
        R"({"accepted":false,"why":"no token is set: this page only watches"})";
    reaction.reply = own_message("token", why);
    return reaction;
  }
  reaction.reply = own_message("token", R"({"accepted":false,"why":"unknown token"})");
  const TokenGuesses::Cost cost = guesses_.on_wrong(client_, now);
  reaction.report = cost.report;
  if (now < answer_due_) {  // the client does not wait for answers, so it needs none
    reaction.ends = true;
    return reaction;
  }
  reaction.delay = cost.delay;
  answer_due_ = now + reaction.delay;
  return reaction;
}

PageSession::Reaction PageSession::on_command(CommandRequest command, TimePoint now) {
  if (!holder_) return {refusal(command.topic, "this page only watches: it has sent no token")};
  if (holder_->role != Role::operator_)
    return {refusal(command.topic, holder_->name + " may watch, but not send commands")};
  if (!topics_.may_publish(command.topic))
    return {refusal(command.topic,
                    "commands may go only to <prefix>/server/<id>/<type> and "
                    "<prefix>/gateway/<gw>/request/permit_join")};
  if (!take_turn(now)) return {refusal(command.topic, "too many commands at once")};
  command.sender = holder_->name + ", page at " + client_.name;
  return {"", std::move(command)};
}

PageSession::Reaction PageSession::on_history(HistoryRequest request, TimePoint now) {
  Reaction reaction;
  if (may_watch() && take_turn(now)) reaction.history = std::move(request.robots);
  return reaction;
}

std::string refusal(std::string_view topic, std::string_view why) {
  return own_message("refused", dumped({{"topic", topic}, {"why", why}}));
}

}  // namespace slamgw::web
