// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/disk_store.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw {
namespace {

TimePoint now() { return std::chrono::steady_clock::now(); }

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
    if (log_) log_->repair();
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
    done(std::visit([this](const auto& what) { return log_->answer(what); }, order));
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
    if constexpr (is_load) {
      log_->serve(request, is_given_up());
      failing_since_.reset();
    } else if constexpr (std::is_same_v<Request, RetryDeadLetters>) {
      log_->serve(request, patience_.unreadable);
    } else {
      log_->serve(request);
    }
  } catch (const LogError& error) {
    if (is_load && error.is_io_error() && !failing_since_) failing_since_ = now();
    post(Failed{error.what()});
  }
}

/// Returns true when the disk has failed for `patience_.unreadable`: unreadable records are lost.
bool DiskStore::is_given_up() const {
  return failing_since_ && now() - *failing_since_ >= patience_.unreadable;
}

void DiskStore::open() {
  if (!closed_since_) closed_since_ = now();
  try {
    log_.emplace(settings_, is_given_up(), [this](StoreEvent event) { post(std::move(event)); });
    failing_since_.reset();
    if (!std::exchange(why_reported_, {}).empty())
      notify(Severity::notice, fmt::format("the store {} is open now", settings_.directory));
    log_->report_opened();
    return try_again_after(patience_.reopen);
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
    log_->repair();
    try_again_after(patience_.reopen);
  });
}

void DiskStore::post(StoreEvent event) {
  thread_.report([this, what = std::move(event)]() mutable { on_event_(std::move(what)); });
}

void DiskStore::notify(Severity severity, std::string text) {
  post(Notice{severity, std::move(text), {}});
}

}  // namespace slamgw
