// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/disk_store.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>

#include <utility>

namespace slamgw {
namespace {

TimePoint now() { return std::chrono::steady_clock::now(); }

using nlohmann::json;

OrderAnswer in_json(const json& document) {
  return {document.dump(-1, ' ', false, json::error_handler_t::replace), {}};
}

json to_json(const ListedDeadLetter& letter, bool with_payload) {
  const BrokerMessage& message = letter.record.message;
  const DeadLetterFacts& facts = *letter.record.dead;
  json out{{"id", letter.id},
           {"topic", message.topic},
           {"bytes", message.payload.size()},
           {"qos", static_cast<int>(message.qos)},
           {"retain", message.retain},
           {"reason", facts.reason},
           {"code", facts.code},
           {"tries", facts.tries},
           {"stored_at", to_iso8601_ms(letter.record.stored_at)},
           {"set_aside_at", to_iso8601_ms(facts.set_aside_at)},
           {"mesh", nullptr},
           {"received_at", nullptr}};
  if (message.provenance) {
    out["mesh"] = to_string(message.provenance->mesh);
    out["received_at"] = to_iso8601_ms(message.provenance->received_at);
  }
  if (letter.is_unreadable)
    for (const char* key : {"stored_at", "set_aside_at", "qos", "retain", "code", "tries"})
      out[key] = nullptr;
  else if (with_payload)
    out["payload_hex"] = to_hex(message.payload);
  return out;
}

std::string range_of(const RecordLog::Summary& lost) {
  return lost.lost_at_least == lost.lost_at_most
             ? fmt::format("{}", lost.lost_at_least)
             : fmt::format("{} to {}", lost.lost_at_least, lost.lost_at_most);
}

}  // namespace

DiskStore::DiskStore(boost::asio::io_context& io, StoreSettings settings,
                     std::function<void(StoreEvent)> on_event, StorePatience patience)
    : settings_(std::move(settings)),
      patience_(patience),
      on_event_(std::move(on_event)),
      thread_(io),
      timer_(thread_.context()) {}

DiskStore::~DiskStore() { stop(); }

void DiskStore::start() {
  thread_.run([this] { open(); });
}

void DiskStore::stop() {
  thread_.run([this] {
    if (log_) write_erasures();
    log_.reset();
  });
  thread_.stop();
}

void DiskStore::ask(StoreRequest request) {
  thread_.run([this, request = std::move(request)] {
    std::visit([this](const auto& what) { serve(what); }, request);
  });
}

void DiskStore::perform(StoreOrder order, OrderDone done) {
  const OrderDone report = [this, done = std::move(done)](OrderAnswer answer) {
    thread_.report([done, what = std::move(answer)] { done(what); });
  };
  thread_.run([this, order = std::move(order), report] { serve(order, report); });
}

void DiskStore::serve(const StoreOrder& order, const OrderDone& done) {
  if (!log_) return done({{}, "there is no store: " + why_closed_});
  try {
    done(std::visit([this](const auto& what) { return answer(what); }, order));
  } catch (const LogError& error) {
    done({{}, fmt::format("store error: {}", error.what())});
  }
}

template <class Request>
void DiskStore::serve(const Request& request) {
  constexpr bool is_load = std::is_same_v<Request, LoadFromStore>;
  using Failed = std::conditional_t<is_load, StoreLoadFailed, StoreWriteFailed>;
  if (!log_) return;  // the outbox asks after StoreOpened only
  try {
    perform(request);
  } catch (const LogError& error) {
    if (is_load && error.is_io_error() && !failing_since_) failing_since_ = now();
    post(Failed{error.what()});
  }
}

void DiskStore::perform(const WriteToStore& write) {
  restore_files();
  const std::size_t damaged = log_->write(write);
  post(StoreWritten{});
  report_damaged(damaged);
  if (!write.dead_letters.empty()) post(DeadLettersChanged{log_->dead_letters()});
}

void DiskStore::perform(const LoadFromStore& load) {
  StoreLoaded loaded = log_->load(load, is_given_up());
  failing_since_.reset();
  const std::size_t damaged = loaded.damaged.size();
  post(std::move(loaded));
  report_damaged(damaged);
}

void DiskStore::perform(const RetryDeadLetters& retry) {
  try {
    while (true) {
      const auto ids = log_->retried(retry.topic, retry.max_letters + max_unreadable);
      std::span<const std::uint64_t> left(ids);
      if (revive(left, retry.max_letters, retry.topic) > 0) break;
      if (!ids.empty()) continue;
      post(DeadLettersRevived{{}, retry.topic});
      break;
    }
  } catch (const LogError& error) {
    post(DeadLettersRevived{{}, retry.topic, error.what()});
  }
  if (const std::string why = log_->take_why_given_up(); !why.empty())
    notify(Severity::error,
           fmt::format("dead letters on {} wait for an operator: {}", retry.topic, why));
}

/// Returns the number of letters that are messages again. Removes the ids from `ids` that it has
/// tried.
std::size_t DiskStore::revive(std::span<const std::uint64_t>& ids, std::size_t most,
                              const std::string& topic) {
  restore_files();
  const Duration patience = topic.empty() ? Duration::max() : patience_.unreadable;
  MessageLog::Revival revival = log_->revive(ids, most, patience);
  ids = ids.subspan(revival.tried);
  const std::size_t count = revival.messages.size();
  report_damaged(revival.damaged.size());
  if (count > 0) post(DeadLettersRevived{std::move(revival.messages), topic});
  post(DeadLettersChanged{log_->dead_letters(), std::move(revival.damaged)});
  return count;
}

OrderAnswer DiskStore::answer(const ListDeadLetters& order) const {
  json letters = json::array();
  for (const auto& listed : log_->list(order.topic, order.after, page_letters, page_bytes))
    letters.push_back(to_json(listed, order.with_payloads));
  const DeadLetterCounts counts = log_->dead_letters();
  const bool is_more = !letters.empty();
  return in_json({{"count", counts.count},
                  {"bytes", counts.bytes},
                  {"letters", std::move(letters)},
                  {"more", is_more}});
}

OrderAnswer DiskStore::answer(const DiscardOrder& order) {
  restore_files();
  auto discarded = log_->discard(log_->ids(order.choice));
  const std::size_t count = discarded.size();
  post(DeadLettersChanged{log_->dead_letters(), std::move(discarded)});
  return in_json({{"discarded", count}});
}

OrderAnswer DiskStore::answer(const ResendOrder& order) {
  const auto ids = log_->ids(order.choice);
  std::span<const std::uint64_t> left(ids);
  std::size_t resent = 0;
  try {
    while (!left.empty()) resent += revive(left, revived_at_once, {});
  } catch (const LogError&) {
    // The disk fails: the other dead letters stay.
  }
  return in_json({{"resent", resent}, {"left", log_->ids(order.choice).size()}});
}

/// Returns true when the disk has failed for `patience_.unreadable`: unreadable records are lost.
bool DiskStore::is_given_up() const {
  return failing_since_ && now() - *failing_since_ >= patience_.unreadable;
}

void DiskStore::open() {
  if (!closed_since_) closed_since_ = now();
  try {
    log_.emplace(settings_.directory, settings_.max_bytes, is_given_up());
    return on_opened();
  } catch (const LogError& error) {
    why_closed_ = error.what();
    if (!error.is_io_error()) failing_since_.reset();
    if (error.is_io_error() && !failing_since_) failing_since_ = now();
    if (error.is_io_error() && now() - *closed_since_ < patience_.opening)
      return try_again_after(patience_.check);
  }
  report_closed();
  try_again_after(failing_since_ && !is_given_up() ? patience_.check : patience_.reopen);
}

void DiskStore::on_opened() {
  failing_since_.reset();
  report_losses();
  if (!std::exchange(why_reported_, {}).empty())
    notify(Severity::notice, fmt::format("the store {} is open now", settings_.directory));
  try_again_after(patience_.reopen);
  post(log_->take_opened());
}

void DiskStore::report_losses() {
  const RecordLog::Summary& lost = log_->lost();
  if (lost.strays > 0)
    notify(Severity::warning,
           fmt::format("{} files in {} belong to another store, or are copies: they are left "
                       "alone, and their messages are not delivered",
                       lost.strays, settings_.directory));
  if (lost.lost_at_most == 0) return;
  post(MessagesLost{
      lost.lost_at_most,
      fmt::format("the store is damaged ({}): {} messages are lost", lost.where, range_of(lost))});
}

void DiskStore::report_damaged(std::size_t messages) {
  if (messages == 0) return;
  post(
      MessagesLost{messages, fmt::format("the store is damaged ({}/messages): {} messages are lost",
                                         settings_.directory, messages)});
}

/// Reports to the outbox once that there is no store.
void DiskStore::report_closed() {
  const bool is_first = why_reported_.empty();
  if (std::exchange(why_reported_, why_closed_) != why_closed_) {
    notify(Severity::warning,
           fmt::format("no store: {}. Robots get their acknowledgements from the broker only; "
                       "undelivered messages do not survive a restart",
                       why_closed_));
  }
  if (is_first) post(StoreAbsent{why_closed_});
}

void DiskStore::try_again_after(std::chrono::milliseconds time) {
  timer_.after(time, [this] {
    if (!log_) return open();
    try {
      restore_files();
    } catch (const LogError&) {
      // The next request fails with the same error.
    }
    write_erasures();
    try_again_after(patience_.reopen);
  });
}

/// Writes erasures that could not be written before.
void DiskStore::write_erasures() {
  try {
    if (log_->log().owes_erasures()) log_->log().commit(true);
  } catch (const LogError&) {
    // They are tried again; a new process would find the messages.
  }
}

/// Restores files of the log that were moved, removed or replaced. Throws LogError.
void DiskStore::restore_files() {
  const auto written = log_->log().put_back_in_place();
  if (written.empty()) return;
  notify(Severity::error,
         fmt::format("{} was moved, removed or replaced while in use; its contents are restored "
                     "(a replaced file is now {}.replaced)",
                     fmt::join(written, ", "), written.back()));
}

void DiskStore::post(StoreEvent event) {
  thread_.report([this, what = std::move(event)]() mutable { on_event_(std::move(what)); });
}

void DiskStore::notify(Severity severity, std::string text) {
  post(Notice{severity, std::move(text), {}});
}

}  // namespace slamgw
