// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite_store.hpp"

#include <fmt/format.h>

#include <utility>

#include "daemon/storage/store_file.hpp"

namespace slamgw {

SqliteStore::SqliteStore(boost::asio::io_context& io, StoreSettings settings,
                         std::function<void(StoreEvent)> on_event)
    : settings_(std::move(settings)),
      path_(settings_.directory + "/messages.db"),
      on_event_(std::move(on_event)),
      thread_(io),
      reopen_timer_(thread_.context()) {}

SqliteStore::~SqliteStore() { stop(); }

void SqliteStore::start() {
  thread_.run([this] { open(); });
}

void SqliteStore::stop() {
  thread_.run([this] { file_.reset(); });
  thread_.stop();
}

void SqliteStore::ask(WriteToStore write) {
  thread_.run([this, request = std::move(write)] { serve(request); });
}

void SqliteStore::ask(LoadFromStore load) {
  thread_.run([this, load] { serve(load); });
}

template <class Request>
void SqliteStore::serve(const Request& request) {
  if (!file_ || request.generation != generation_) return;  // it meant another file
  try {
    post(perform(request));
  } catch (const SqliteError& error) {
    if constexpr (std::is_same_v<Request, WriteToStore>) {
      post(StoreWriteFailed{error.what()});
    } else {
      post(StoreLoadFailed{error.what()});
    }
    if (!error.is_corrupt()) return;
    move_aside(error.what());
    open();
  }
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
  if (!file_) try_again_later();
}

void SqliteStore::try_again_later() {
  reopen_timer_.expires_after(reopen_interval);
  reopen_timer_.async_wait([this](boost::system::error_code error) {
    if (!error) open();
  });
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
  thread_.report([this, what = std::move(event)]() mutable { on_event_(std::move(what)); });
}

}  // namespace slamgw
