// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/sqlite_store.hpp"

#include <fmt/format.h>
#include <sqlite3.h>

#include <utility>

#include "daemon/storage/store_file.hpp"

namespace slamgw {
namespace {

TimePoint now() { return std::chrono::steady_clock::now(); }

std::string saved_text(const MessageRecovery::Result& result) {
  std::string text = fmt::format("{} messages", result.messages);
  if (result.dead_letters > 0) text += fmt::format(" and {} dead letters", result.dead_letters);
  text += " were saved";
  if (result.damaged > 0) {
    text += fmt::format(", {} damaged ones became dead letters", result.damaged);
  }
  if (!result.lost_messages) return text + ", and how many are lost is not known";
  const auto [at_least, at_most] = *result.lost_messages;
  text += at_least == at_most ? fmt::format(", {} are lost", at_least)
                              : fmt::format(", {} to {} are lost", at_least, at_most);
  if (*result.lost_dead_letters > 0) {
    text += fmt::format(" and {} dead letters", *result.lost_dead_letters);
  }
  return text;
}

/// Rows that are dead letters again should the write fail.
std::vector<std::uint64_t> resent_rows(const WriteToStore& write) {
  std::vector<std::uint64_t> rows;
  for (const StoredMessage& stored : write.keep) {
    if (stored.dead_letter != 0) rows.push_back(stored.row);
  }
  return rows;
}

}  // namespace

SqliteStore::SqliteStore(boost::asio::io_context& io, StoreSettings settings,
                         std::function<void(StoreEvent)> on_event, StorePatience patience)
    : settings_(std::move(settings)),
      patience_(patience),
      path_(settings_.directory + "/messages.db"),
      replacement_(path_),
      on_event_(std::move(on_event)),
      verdict_(patience.unreadable),
      thread_(io),
      timer_(thread_.context()),
      dead_letter_desk_(thread_.context(), patience.resend,
                        [this](ResendDeadLetters page) { post(std::move(page)); }) {}

SqliteStore::~SqliteStore() { stop(); }

void SqliteStore::start() {
  thread_.run([this] { open(); });
}

void SqliteStore::stop() {
  thread_.run([this] {
    file_.reset();
    tally_.reset();
  });
  thread_.stop();
}

void SqliteStore::ask(WriteToStore write) {
  thread_.run([this, request = std::move(write)] { serve(request); });
}

void SqliteStore::ask(LoadFromStore load) {
  thread_.run([this, request = std::move(load)] { serve(request); });
}

void SqliteStore::perform(StoreOrder order, OrderDone done) {
  const OrderDone report = [this, done = std::move(done)](OrderAnswer answer) {
    thread_.report([done, what = std::move(answer)] { done(what); });
  };
  thread_.run([this, order = std::move(order), report] { serve(order, report); });
}

void SqliteStore::serve(const StoreOrder& order, const OrderDone& done) {
  if (!file_) return done({{}, "there is no store: " + why_closed_});
  try {
    const DeadLetterCounts before = file_->dead_letters();
    if (const auto* resend = std::get_if<ResendOrder>(&order)) {
      dead_letter_desk_.perform(*resend, *file_, done);
    } else if (const auto* discard = std::get_if<DiscardOrder>(&order)) {
      done(dead_letter_desk_.perform(*discard, *file_));
    } else {
      done(dead_letter_desk_.perform(std::get<ListDeadLetters>(order), *file_));
    }
    if (before != file_->dead_letters()) post(DeadLettersChanged{file_->dead_letters()});
  } catch (const SqliteError& error) {
    done({{}, fmt::format("the store fails: {}", error.what())});
    on_request_failed(error, false);
  }
}

template <class Request>
void SqliteStore::serve(const Request& request) {
  constexpr bool is_load = std::is_same_v<Request, LoadFromStore>;
  using Failed = std::conditional_t<is_load, StoreLoadFailed, StoreWriteFailed>;
  if (request.generation != generation_) return;  // it meant another file
  if (!file_) {
    if (is_open_for_outbox_) post(Failed{why_closed_});
    return;
  }
  try {
    perform(request);
  } catch (const SqliteError& error) {
    post(Failed{error.what()});
    on_request_failed(error, is_load);
  }
}

void SqliteStore::perform(const WriteToStore& write) {
  if (!file_->is_in_place()) put_back_in_place();
  const DeadLetterCounts before = file_->dead_letters();
  unconfirmed_ = resent_rows(write);
  file_->write(write);
  unconfirmed_.clear();
  if (!write.keep.empty()) last_kept_row_ = write.keep.back().row;
  post(StoreWritten{});
  dead_letter_desk_.on_written(write, *file_);
  if (before != file_->dead_letters()) post(DeadLettersChanged{file_->dead_letters()});
}

void SqliteStore::perform(const LoadFromStore& load) {
  StoreLoaded loaded = file_->load(load);
  verdict_.reset();
  const std::size_t damaged = loaded.damaged.size();
  post(std::move(loaded));
  if (damaged == 0) return;
  notify(Severity::error,
         fmt::format("{} messages in {} are damaged: they are dead letters now (slam-gatewayctl "
                     "store list)",
                     damaged, path_));
  post(DeadLettersChanged{file_->dead_letters()});
}

/// Errors of the disk go away or stay; only when they stay, and for damage, the file is examined.
void SqliteStore::on_request_failed(const SqliteError& error, bool is_load) {
  if (error.is_io_error() && is_load) verdict_.on_read_error(now());
  if (!error.is_corrupt() && !verdict_.is_persistent(now())) return;
  why_closed_ = fmt::format("{}: {}", path_, error.what());
  close_as_it_is();
  open();
}

void SqliteStore::close_as_it_is() {
  if (file_) file_->leave_log_on_close();
  file_.reset();
}

void SqliteStore::open() {
  if (!closed_since_) closed_since_ = now();
  try {
    try_to_open();
    return on_opened();
  } catch (const SqliteError& error) {
    close_as_it_is();
    why_closed_ = fmt::format("{}: {}", path_, words_for(error));
    const bool is_doubtful = error.is_corrupt() || error.is_io_error();
    if (is_doubtful && save_if_damaged(error)) return open();
    if (is_doubtful && now() - *closed_since_ < patience_.opening) {
      return try_again_after(patience_.check);
    }
  } catch (const ForeignFile& error) {
    close_as_it_is();
    why_closed_ = fmt::format("{} is left as it is: {}", path_, error.what());
  } catch (const std::runtime_error& error) {
    close_as_it_is();
    why_closed_ = error.what();
  }
  report_closed();
  try_again_after(patience_.reopen);
}

void SqliteStore::try_to_open() {
  make_store_directory(settings_.directory);
  if (!tally_) tally_.emplace(path_ + "-tally");
  replacement_.finish_what_was_begun("corrupt");
  make_store_file(settings_.directory, path_);
  file_.emplace(path_, settings_.max_bytes, &*tally_);
  // What was not confirmed is in the outbox's memory still.
  if (is_open_for_outbox_) file_->drop_messages_above(last_kept_row_, unconfirmed_);
}

void SqliteStore::on_opened() {
  StoreOpened opened = file_->summary();
  verdict_.reset();
  closed_since_.reset();
  unconfirmed_.clear();
  if (const auto& missed = file_->missed(); missed && missed->messages + missed->dead_letters > 0) {
    notify(Severity::error,
           fmt::format("{} is not the file that was written last: {} messages and {} dead letters "
                       "that were stored are not in it",
                       path_, missed->messages, missed->dead_letters));
  }
  if (!std::exchange(why_reported_, {}).empty()) {
    notify(Severity::notice, fmt::format("the store {} could be opened now", path_));
  }
  try_again_after(patience_.reopen);
  if (is_open_for_outbox_) return post(DeadLettersChanged{file_->dead_letters()});
  is_open_for_outbox_ = true;
  ++generation_;
  last_kept_row_ = opened.last_row;
  post(std::move(opened));
}

/// True when what is left of a damaged file is in its place. What goes wrong is tried again at
/// the next check.
bool SqliteStore::save_if_damaged(const SqliteError& why) {
  try {
    if (!tally_) return false;
    MessageRecovery recovery(path_, tally_->read());
    const bool is_readable = recovery.unreadable() == 0;
    if (!verdict_.is_damaged(recovery.unreadable(), now())) return false;
    if (!is_readable && !recovery.has_found_anything()) return false;  // the disk is away
    if (is_readable && !why.is_corrupt()) return false;
    save(recovery, why.what());
    verdict_.reset();
    return true;
  } catch (const std::runtime_error& error) {
    why_closed_ = fmt::format("{} is damaged ({}), and what is left of it cannot be saved: {}",
                              path_, why.what(), error.what());
    return false;
  }
}

void SqliteStore::save(MessageRecovery& recovery, const std::string& why) {
  recovery.save_to(replacement_.begin(), settings_.max_bytes);
  const std::string aside = replacement_.finish(damaged_word);
  notify(Severity::error, fmt::format("the store {} was damaged ({}): {}; the damaged file is {}",
                                      path_, why, saved_text(recovery.result()), aside));
}

/// The file was moved, removed or replaced while it was open: what it holds is written
/// there again.
void SqliteStore::put_back_in_place() {
  try {
    make_store_directory(settings_.directory);
    file_->copy_to(replacement_.begin());
    const std::string aside = replacement_.finish("replaced");
    close_as_it_is();
    tally_.reset();
    try_to_open();
    notify(
        Severity::error,
        fmt::format("{} was moved, removed or replaced while it was in use: what it held is there "
                    "again{}",
                    path_, aside.empty() ? "" : "; what was there instead is " + aside));
  } catch (const SqliteError&) {
    throw;
  } catch (const std::runtime_error& error) {
    throw SqliteError(SQLITE_CANTOPEN, error.what());
  }
}

/// Reports to the outbox that there is no store, but only while it knows of none.
void SqliteStore::report_closed() {
  const bool is_first = why_reported_.empty();
  if (std::exchange(why_reported_, why_closed_) != why_closed_) {
    notify(Severity::warning,
           fmt::format("no store: {}. Robots get their acknowledgements from the broker only; "
                       "what is undelivered does not survive a restart",
                       why_closed_));
  }
  if (is_open_for_outbox_ || !is_first) return;
  ++generation_;
  post(StoreAbsent{why_closed_});
}

void SqliteStore::try_again_after(std::chrono::milliseconds time) {
  timer_.expires_after(time);
  timer_.async_wait([this](boost::system::error_code error) {
    if (error) return;
    if (file_) return check_place();
    open();
  });
}

void SqliteStore::check_place() {
  try {
    if (!file_->is_in_place()) put_back_in_place();
  } catch (const SqliteError& error) {
    why_closed_ = fmt::format("{}: {}", path_, error.what());
    if (!file_) return open();
  }
  try_again_after(patience_.reopen);
}

void SqliteStore::post(StoreEvent event) {
  thread_.report([this, what = std::move(event)]() mutable { on_event_(std::move(what)); });
}

void SqliteStore::notify(Severity severity, std::string text) {
  post(Notice{severity, std::move(text), {}});
}

}  // namespace slamgw
