// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite_store.hpp"

#include <fmt/format.h>

#include <boost/asio/post.hpp>
#include <cassert>
#include <utility>

#include "daemon/storage/store_file.hpp"

namespace slamgw {

SqliteStore::SqliteStore(boost::asio::io_context& io, StoreSettings settings,
                         std::function<void(StoreEvent)> on_event)
    : io_(io),
      settings_(std::move(settings)),
      path_(settings_.directory + "/messages.db"),
      on_event_(std::make_shared<std::function<void(StoreEvent)>>(std::move(on_event))) {}

SqliteStore::~SqliteStore() { stop(); }

void SqliteStore::start() {
  thread_ = std::thread([this] { run(); });
}

void SqliteStore::stop() {
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    is_stopping_ = true;
  }
  wake_.notify_one();
  thread_.join();
  *on_event_ = nullptr;
}

void SqliteStore::ask_any(Request request) {
  const std::lock_guard lock(mutex_);
  assert(requests_.size() < max_requests);
  requests_.push_back(std::move(request));
  wake_.notify_one();
}

void SqliteStore::run() {
  open();
  while (const auto request = next_request()) serve(*request);
  file_.reset();
}

/// Nothing when it is time to end. Meanwhile tries to open the file while there is none.
std::optional<SqliteStore::Request> SqliteStore::next_request() {
  std::unique_lock lock(mutex_);
  const auto is_awaited = [this] { return is_stopping_ || !requests_.empty(); };
  while (!file_ && !wake_.wait_for(lock, reopen_interval, is_awaited)) {
    lock.unlock();
    open();
    lock.lock();
  }
  wake_.wait(lock, is_awaited);
  if (requests_.empty()) return std::nullopt;
  Request request = std::move(requests_.front());
  requests_.pop_front();
  return request;
}

void SqliteStore::serve(const Request& request) {
  std::visit(
      [this](const auto& what) {
        if (!file_ || what.generation != generation_) return;  // it meant another file
        try {
          post(perform(what));
        } catch (const SqliteError& error) {
          using What = std::decay_t<decltype(what)>;
          if constexpr (std::is_same_v<What, WriteToStore>) {
            post(StoreWriteFailed{error.what()});
          } else {
            post(StoreLoadFailed{error.what()});
          }
          if (!error.is_corrupt()) return;
          move_aside(error.what());
          open();
        }
      },
      request);
}

StoreEvent SqliteStore::perform(const WriteToStore& write) {
  file_->write(write);
  return StoreWritten{};
}

StoreEvent SqliteStore::perform(const LoadFromStore& load) { return file_->load(load); }

void SqliteStore::open() {
  try {
    try {
      try_to_open();
    } catch (const SqliteError& error) {
      if (!error.is_corrupt()) throw;
      move_aside(error.what());
      try_to_open();
    }
  } catch (const SqliteError& error) {
    go_without(path_ + ": " +
               (error.is_locked() ? "another process has it open; does a second slam-gatewayd run?"
                                  : error.what()));
  } catch (const ForeignFile& error) {
    go_without(fmt::format("{} is left as it is: {}", path_, error.what()));
  } catch (const std::runtime_error& error) {
    go_without(error.what());
  }
}

void SqliteStore::try_to_open() {
  make_store_file(settings_.directory, path_);
  file_.emplace(path_, settings_.max_bytes);
  StoreOpened opened;
  try {
    opened = file_->summary();
  } catch (...) {
    file_.reset();
    throw;
  }
  if (!std::exchange(why_absent_, {}).empty()) {
    post(Notice{Severity::notice, fmt::format("the store {} could be opened now", path_), {}});
  }
  ++generation_;
  post(std::move(opened));
}

void SqliteStore::go_without(const std::string& why) {
  const bool is_known = generation_ > 0 && !file_ && !why_absent_.empty();
  if (why != why_absent_) {
    why_absent_ = why;
    post(Notice{Severity::warning,
                fmt::format("no store: {}. Robots get their acknowledgements from the broker only; "
                            "what is undelivered does not survive a restart",
                            why),
                {}});
  }
  if (is_known) return;
  ++generation_;
  post(StoreAbsent{why});
}

void SqliteStore::move_aside(const std::string& why) {
  file_.reset();
  const std::string aside = move_store_file_aside(path_);
  post(
      Notice{Severity::error,
             fmt::format("the store {} is damaged ({}): moved to {} and begun anew; messages in it "
                         "are not delivered (`sqlite3 {} .recover` may still read them)",
                         path_, why, aside, aside),
             {}});
}

void SqliteStore::post(StoreEvent event) {
  boost::asio::post(io_, [on_event = on_event_, event = std::move(event)]() mutable {
    if (*on_event) (*on_event)(std::move(event));
  });
}

}  // namespace slamgw
