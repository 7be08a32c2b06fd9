// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/disk_store.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <utility>

namespace slamgw {
namespace {

TimePoint now() { return std::chrono::steady_clock::now(); }

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
      timer_(thread_.context()),
      dead_letter_desk_(thread_.context(), patience.resend,
                        [this](ResendDeadLetters page) { post(std::move(page)); }) {}

DiskStore::~DiskStore() { stop(); }

void DiskStore::start() {
  thread_.run([this] { open(); });
}

void DiskStore::stop() {
  thread_.run([this] { log_.reset(); });
  thread_.stop();
}

void DiskStore::ask(WriteToStore write) {
  thread_.run([this, request = std::move(write)] { serve(request); });
}

void DiskStore::ask(LoadFromStore load) {
  thread_.run([this, request = std::move(load)] { serve(request); });
}

void DiskStore::ask(RetryDeadLetters retry) {
  thread_.run([this, request = std::move(retry)] { serve(request); });
}

void DiskStore::perform(StoreOrder order, OrderDone done) {
  const OrderDone report = [this, done = std::move(done)](OrderAnswer answer) {
    thread_.report([done, what = std::move(answer)] { done(what); });
  };
  thread_.run([this, order = std::move(order), report] { serve(order, report); });
}

void DiskStore::serve(const StoreOrder& order, const OrderDone& done) {
  if (!log_) return done({{}, "there is no store: " + why_closed_});
  const DeadLetterCounts before = log_->dead_letters();
  try {
    if (const auto* resend = std::get_if<ResendOrder>(&order)) {
      dead_letter_desk_.perform(*resend, *log_, done);
    } else if (const auto* discard = std::get_if<DiscardOrder>(&order)) {
      done(dead_letter_desk_.perform(*discard, *log_));
    } else {
      done(dead_letter_desk_.perform(std::get<ListDeadLetters>(order), *log_));
    }
  } catch (const LogError& error) {
    done({{}, fmt::format("the store fails: {}", error.what())});
  }
  if (before != log_->dead_letters()) post(DeadLettersChanged{log_->dead_letters()});
}

template <class Request>
void DiskStore::serve(const Request& request) {
  constexpr bool is_load = std::is_same_v<Request, LoadFromStore>;
  using Failed = std::conditional_t<is_load, StoreLoadFailed, StoreWriteFailed>;
  if (request.generation != generation_ || !log_) return;  // it meant another store
  try {
    perform(request);
  } catch (const LogError& error) {
    if (is_load && error.is_io_error() && !failing_since_) failing_since_ = now();
    post(Failed{error.what()});
  }
}

void DiskStore::perform(const WriteToStore& write) {
  if (!log_->is_in_place()) check_place();
  const DeadLetterCounts before = log_->dead_letters();
  const std::size_t damaged = log_->write(write);
  post(StoreWritten{});
  report_damaged(damaged);
  dead_letter_desk_.on_written(write, *log_);
  if (before != log_->dead_letters()) post(DeadLettersChanged{log_->dead_letters()});
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
    dead_letter_desk_.perform(retry, *log_);
  } catch (const LogError&) {
    post(ResendDeadLetters{{}, retry.topic});  // none can be read
  }
}

/// The disk has failed to read for so long that what it does not read is lost.
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
  try_again_after(failing_since_ ? patience_.check : patience_.reopen);
}

void DiskStore::on_opened() {
  failing_since_.reset();
  report_losses();
  if (!std::exchange(why_reported_, {}).empty())
    notify(Severity::notice, fmt::format("the store {} could be opened now", settings_.directory));
  try_again_after(patience_.reopen);
  ++generation_;
  post(log_->take_opened());
}

void DiskStore::report_losses() {
  const RecordLog::Summary& messages = log_->lost_messages();
  const RecordLog::Summary& letters = log_->lost_dead_letters();
  if (messages.strays + letters.strays > 0)
    notify(Severity::warning,
           fmt::format("{} files in {} belong to another store: they are left alone, and their "
                       "messages are not delivered",
                       messages.strays + letters.strays, settings_.directory));
  if (messages.lost_at_most + letters.lost_at_most == 0) return;
  std::string text =
      fmt::format("the store is damaged ({}): {} messages are lost",
                  messages.where.empty() ? letters.where : messages.where, range_of(messages));
  if (letters.lost_at_most > 0) text += fmt::format(" and {} dead letters", range_of(letters));
  notify(Severity::error, text);
}

void DiskStore::report_damaged(std::size_t messages) {
  if (messages == 0) return;
  notify(Severity::error, fmt::format("the store is damaged ({}/messages): {} messages are lost",
                                      settings_.directory, messages));
}

/// Reports to the outbox once that there is no store.
void DiskStore::report_closed() {
  const bool is_first = why_reported_.empty();
  if (std::exchange(why_reported_, why_closed_) != why_closed_) {
    notify(Severity::warning,
           fmt::format("no store: {}. Robots get their acknowledgements from the broker only; "
                       "what is undelivered does not survive a restart",
                       why_closed_));
  }
  if (!is_first) return;
  ++generation_;
  post(StoreAbsent{why_closed_});
}

void DiskStore::try_again_after(std::chrono::milliseconds time) {
  timer_.expires_after(time);
  timer_.async_wait([this](boost::system::error_code error) {
    if (error) return;
    if (!log_) return open();
    try {
      check_place();
    } catch (const LogError&) {
      // The next request fails with it.
    }
    try_again_after(patience_.reopen);
  });
}

/// Throws LogError.
void DiskStore::check_place() {
  const auto written = log_->put_back_in_place();
  if (written.empty()) return;
  notify(Severity::error,
         fmt::format("{} was moved, removed or replaced while it was in use: what it held is there "
                     "again; what was there instead is {}.replaced",
                     fmt::join(written, ", "), written.back()));
}

void DiskStore::post(StoreEvent event) {
  thread_.report([this, what = std::move(event)]() mutable { on_event_(std::move(what)); });
}

void DiskStore::notify(Severity severity, std::string text) {
  post(Notice{severity, std::move(text), {}});
}

}  // namespace slamgw
