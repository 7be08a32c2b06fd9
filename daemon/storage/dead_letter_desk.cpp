// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/dead_letter_desk.hpp"

#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw {
namespace {

using nlohmann::json;

OrderAnswer answer(const json& document) {
  return {document.dump(-1, ' ', false, json::error_handler_t::replace), {}};
}

json to_json(const ListedDeadLetter& listed, bool with_payload) {
  const BrokerMessage& message = listed.letter.message;
  json out{{"id", listed.letter.id},
           {"topic", message.topic},
           {"bytes", message.payload.size()},
           {"qos", static_cast<int>(message.qos)},
           {"retain", message.retain},
           {"reason", listed.reason},
           {"code", listed.code},
           {"tries", listed.tries},
           {"stored_at", to_iso8601_ms(listed.stored_at)},
           {"set_aside_at", to_iso8601_ms(listed.set_aside_at)},
           {"mesh", nullptr},
           {"received_at", nullptr}};
  if (message.provenance) {
    out["mesh"] = to_string(message.provenance->mesh);
    out["received_at"] = to_iso8601_ms(message.provenance->received_at);
  }
  if (with_payload) out["payload_hex"] = to_hex(message.payload);
  return out;
}

}  // namespace

OrderAnswer DeadLetterDesk::perform(const ListDeadLetters& order, MessageLog& log) const {
  json letters = json::array();
  const auto page = log.list(order.topic, order.after, page_letters, page_bytes);
  for (const ListedDeadLetter& listed : page) {
    letters.push_back(to_json(listed, order.with_payloads));
  }
  const DeadLetterCounts counts = log.dead_letters();
  return answer({{"count", counts.count},
                 {"bytes", counts.bytes},
                 {"letters", std::move(letters)},
                 {"more", !page.empty()}});
}

OrderAnswer DeadLetterDesk::perform(const DiscardOrder& order, MessageLog& log) const {
  return answer({{"discarded", log.discard(order.choice)}});
}

void DeadLetterDesk::perform(const RetryDeadLetters& retry, MessageLog& log) const {
  ResendDeadLetters page{{}, retry.topic};
  for (ListedDeadLetter& listed : log.retried(retry.topic, retry.max_letters))
    page.letters.push_back(std::move(listed.letter));
  resend_(std::move(page));
}

void DeadLetterDesk::perform(const ResendOrder& order, MessageLog& log, OrderDone done) {
  if (resending_) return done({{}, "dead letters are being sent again already"});
  Resending resending;
  resending.ids = log.ids(order.choice);
  resending.done = std::move(done);
  resending_ = std::move(resending);
  give_page(log);
}

void DeadLetterDesk::on_written(const WriteToStore& write, MessageLog& log) {
  if (!resending_) return;
  std::size_t kept = 0;
  for (const StoredMessage& stored : write.keep)
    kept += resending_->given.erase(stored.dead_letter);
  if (kept == 0) return;
  resending_->resent += kept;
  if (!resending_->given.empty()) return wait();
  try {
    give_page(log);
  } catch (const LogError&) {
    finish();
  }
}

void DeadLetterDesk::give_page(MessageLog& log) {
  ResendDeadLetters page;
  std::size_t bytes = 0;
  std::size_t& next = resending_->next;
  while (next < resending_->ids.size() && page.letters.size() < page_letters &&
         bytes < page_bytes) {
    auto listed = log.find(resending_->ids[next++]);
    if (!listed) continue;
    bytes += listed->letter.message.topic.size() + listed->letter.message.payload.size();
    resending_->given.insert(listed->letter.id);
    page.letters.push_back(std::move(listed->letter));
  }
  if (page.letters.empty()) return finish();
  resend_(std::move(page));
  wait();
}

void DeadLetterDesk::wait() {
  timer_.expires_after(patience_);
  timer_.async_wait([this](boost::system::error_code error) {
    if (!error && resending_) finish();
  });
}

void DeadLetterDesk::finish() {
  timer_.cancel();
  const Resending ended = std::move(*resending_);
  resending_.reset();
  ended.done(answer({{"resent", ended.resent}, {"left", ended.ids.size() - ended.resent}}));
}

}  // namespace slamgw
