// SPDX-License-Identifier: Apache-2.0
// The sessions of one mesh's robots in a log of `store.directory`, written on the disk's thread.
// Without a usable log the daemon goes on, and this class tries again to open it.
//
//   sessions/        of MQTT-SN clients: length of the id (2, little-endian), id, content: CBOR
//   ble-commands/    of BLE robots, the same; content: encode_open_commands()
//
// A written session survives the end of the process at once, and a power cut from the next
// synchronisation on.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/session_store.hpp"
#include "daemon/runtime/timer.hpp"
#include "daemon/storage/record_log.hpp"
#include "daemon/storage/store_thread.hpp"

namespace slamgw {

class DiskSessionStore final : public SessionStore {
 public:
  /// A power cut loses at most the changes of this time.
  static constexpr std::chrono::seconds sync_interval{5};

  /// The kind of sessions that is kept, and the words for it in log lines.
  struct Content {
    std::string folder;  ///< in `store.directory`
    std::string name;
    std::string loss;  ///< the effect of losing it
  };
  static Content mqttsn_sessions() {
    return {"sessions", "sessions of MQTT-SN clients", "those clients have to connect again"};
  }
  static Content ble_commands() {
    return {"ble-commands", "commands under way over BLE", "they have no outcome"};
  }

  /// `on_notice` is called on the loop's thread, not after stop().
  DiskSessionStore(boost::asio::io_context& io, const std::string& directory, Content content,
                   std::function<void(Notice)> on_notice, StorePatience patience = {});
  ~DiskSessionStore() override;

  std::vector<Session> load() override;
  void save(std::vector<Change> changes) override;
  bool is_busy() const override;
  void watch(std::function<void(bool)> on_written) override { on_written_ = std::move(on_written); }
  /// Tries once to write the remaining changes, and waits for that.
  void stop();

 private:
  using Changes = std::map<std::string, std::optional<Bytes>>;

  void write_changes();
  void on_written(bool is_written, Changes changes);

  // On the disk's thread:
  std::vector<Session> open_and_load();
  bool open(bool skips_unreadable, std::vector<Session>& loaded);
  void read_all(bool skips_unreadable, std::vector<Session>& loaded);
  bool write(const Changes& changes);
  void sync_later();
  void sync();
  void report_failure();
  void notice(Severity severity, std::string text);

  const std::string directory_;
  const Content content_;
  const StorePatience patience_;
  const std::function<void(Notice)> on_notice_;  // the loop's thread only

  // The loop's thread only:
  Changes changes_;  // the last of each session, without those in the write under way
  bool is_writing_ = false;
  std::function<void(bool is_written)> on_written_;  // may be empty
  Timer retry_timer_;

  // The disk's thread only:
  std::optional<RecordLog> log_;
  std::map<std::string, std::uint64_t> keys_;  // of the log's records, by session id
  std::uint64_t last_key_ = 0;
  bool is_disk_failing_ = false;  // perhaps only for a moment
  std::string why_closed_;
  std::string why_reported_;  // as last logged
  bool is_sync_due_ = false;  // changes were written since the last sync()

  StoreThread thread_;
  Timer sync_timer_;
};

}  // namespace slamgw
