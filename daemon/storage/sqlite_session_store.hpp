// SPDX-License-Identifier: Apache-2.0
// The shell of SessionFile: `sessions.db` in `store.directory`, written on a thread of its own. Of
// a damaged file everything that can be read is saved, and the file is put aside; without a usable
// one the daemon goes on, and this tries again.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/session_store.hpp"
#include "daemon/storage/file_replacement.hpp"
#include "daemon/storage/sqlite.hpp"
#include "daemon/storage/store_file.hpp"
#include "daemon/storage/store_thread.hpp"

namespace slamgw {

/// `sessions.db`: the sessions of MQTT-SN clients, one row each. Blocks; used by
/// SqliteSessionStore.
///
///   sessions(id TEXT PRIMARY KEY, content BLOB, checksum)    content: CBOR (adapters/mqttsn_udp)
///
/// Write-ahead log without a synchronisation for each commit: what is written survives the end of
/// the process at once, and a power cut from the next sync() on. `user_version` is 2 (1 had no
/// checksums).
class SessionFile {
 public:
  static constexpr int version = 2;
  static constexpr std::uint64_t max_bytes = std::uint64_t{256} << 20;

  struct Loaded {
    std::vector<SessionStore::Session> sessions;
    std::size_t damaged = 0;  ///< not what was written, and gone now
  };

  /// Opens an existing file of ours, or makes an empty one ours. Throws SqliteError and
  /// ForeignFile.
  explicit SessionFile(const std::string& path);

  Loaded load();
  void write(const std::vector<SessionStore::Change>& changes);
  void sync();
  /// Everything is in the file itself when this returns, and durable; the log beside it is empty.
  void move_log_into_file() { database_.move_log_into_file(); }
  /// Closing changes nothing then.
  void leave_log_on_close() { database_.keep_log_on_close(true); }

 private:
  SqliteDatabase database_;
  SqliteStatement replace_;
  SqliteStatement erase_;
};

/// Whole sessions that are left in a damaged file and its log; the newest version of each that is.
/// Used while the file is closed. Throws SqliteError when a file cannot be opened.
struct SavedSessions {
  explicit SavedSessions(const std::string& path);

  std::vector<SessionStore::Change> sessions;
  std::size_t unreadable = 0;  ///< parts that the disk could not read
};

class SqliteSessionStore final : public SessionStore {
 public:
  /// What a power cut may take back at most.
  static constexpr std::chrono::seconds sync_interval{5};

  /// `on_notice` is called on the loop's thread, not after stop().
  SqliteSessionStore(boost::asio::io_context& io, std::string directory,
                     std::function<void(Notice)> on_notice, StorePatience patience = {});
  ~SqliteSessionStore() override;

  std::vector<Session> load() override;
  void save(std::vector<Change> changes) override;
  bool is_busy() const override;
  void watch(std::function<void(bool)> on_written) override { on_written_ = std::move(on_written); }
  /// Writes what is still to be written, once, and waits for that.
  void stop();

 private:
  using Changes = std::map<std::string, std::optional<Bytes>>;

  void write_changes();
  void on_written(bool is_written, Changes changes);

  // On the store's thread:
  std::vector<Session> open_and_load();
  bool open();
  void try_to_open();
  bool save_if_damaged(const SqliteError& why);
  void close_as_it_is();
  bool write(const Changes& changes);
  void sync_later();
  void sync();
  void report_failure();
  void notice(Severity severity, std::string text);

  const std::string directory_;
  const std::string path_;
  const FileReplacement replacement_;
  const StorePatience patience_;
  const std::function<void(Notice)> on_notice_;  // the loop's thread only

  // The loop's thread only:
  Changes changes_;  // the last of each session that is not written and not being written
  bool is_writing_ = false;
  std::function<void(bool is_written)> on_written_;  // may be empty
  boost::asio::steady_timer retry_timer_;

  // The store's thread only:
  std::optional<SessionFile> file_;
  DamageVerdict verdict_;
  std::vector<Session> loaded_;  // what the file held when it was opened
  bool is_doubtful_ = false;     // the disk may only fail for a moment
  std::string why_closed_;
  std::string why_reported_;  // as last logged
  bool is_sync_due_ = false;  // something is written since the last sync()

  StoreThread thread_;
  boost::asio::steady_timer sync_timer_;
};

}  // namespace slamgw
