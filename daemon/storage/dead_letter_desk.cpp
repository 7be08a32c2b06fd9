// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/dead_letter_desk.hpp"

#include <fmt/format.h>

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

void DeadLetterDesk::perform(const ResendOrder& order, MessageLog& log, OrderDone done) {
  orders_.push_back({order.choice, {}, std::move(done)});
  begin_next(log);
}

void DeadLetterDesk::perform(const RetryDeadLetters& retry, MessageLog& log) {
  if (retry.is_all) {
    orders_.push_back({{}, retry.topic});
    return begin_next(log);
  }
  ResendDeadLetters one{{}, retry.topic};
  if (auto listed = log.first_retried(retry.topic))
    one.letters.push_back(std::move(listed->letter));
  resend_(std::move(one));
}

void DeadLetterDesk::begin_next(MessageLog& log) {
  if (resending_ || orders_.empty()) return;
  resending_ = Resending();
  resending_->order = std::move(orders_.front());
  orders_.pop_front();
  const Order& order = resending_->order;
  try {
    resending_->ids =
        order.retried_topic.empty() ? log.ids(order.choice) : log.retried(order.retried_topic);
  } catch (const LogError& error) {
    if (order.done) order.done({{}, fmt::format("the store fails: {}", error.what())});
    if (!order.done) orders_.push_back(order);
    resending_.reset();
    return wait(log);
  }
  give_page(log);
}

void DeadLetterDesk::on_written(const WriteToStore& write, MessageLog& log) {
  if (!resending_) return;
  std::size_t kept = 0;
  for (const StoredMessage& stored : write.keep)
    kept += resending_->given.erase(stored.dead_letter);
  if (kept == 0) return;
  resending_->resent += kept;
  resending_->given.empty() ? give_page(log) : wait(log);
}

void DeadLetterDesk::give_page(MessageLog& log) {
  ResendDeadLetters page;
  std::size_t bytes = 0;
  std::size_t& next = resending_->next;
  try {
    while (next < resending_->ids.size() && page.letters.size() < page_letters &&
           bytes < page_bytes) {
      auto listed = log.find(resending_->ids[next]);
      ++next;
      if (!listed) continue;
      bytes += listed->letter.message.topic.size() + listed->letter.message.payload.size();
      resending_->given.insert(listed->letter.id);
      page.letters.push_back(std::move(listed->letter));
    }
  } catch (const LogError&) {
    // The page ends here; without one, so does the order.
  }
  if (page.letters.empty()) return finish(log);
  resend_(std::move(page));
  wait(log);
}

/// For the outbox, or for a disk that fails.
void DeadLetterDesk::wait(MessageLog& log) {
  timer_.expires_after(patience_);
  timer_.async_wait([this, &log](boost::system::error_code error) {
    if (error) return;
    resending_ ? finish(log) : begin_next(log);
  });
}

void DeadLetterDesk::finish(MessageLog& log) {
  timer_.cancel();
  Resending ended = std::move(*resending_);
  resending_.reset();
  const std::size_t left = ended.ids.size() - ended.resent;
  if (ended.order.done) ended.order.done(answer({{"resent", ended.resent}, {"left", left}}));
  const bool is_left = ended.next < ended.ids.size() || !ended.given.empty();
  if (ended.order.done || !is_left) return begin_next(log);
  orders_.push_back(std::move(ended.order));
  wait(log);
}

}  // namespace slamgw
