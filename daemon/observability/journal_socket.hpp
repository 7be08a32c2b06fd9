// SPDX-License-Identifier: Apache-2.0
// Datagrams to systemd-journald that never wait for it: libsystemd's sd_journal_send() blocks when
// the journal is stuck, and the loop with it. What matters is kept until the journal takes it, the
// rest is counted. Loop's thread only.
#pragma once

#include <cstdint>
#include <deque>
#include <string>

namespace slamgw {

class JournalSocket {
 public:
  /// Entries kept while the journal takes nothing; all further ones are lost.
  static constexpr std::size_t max_kept = 256;

  explicit JournalSocket(std::string path);
  ~JournalSocket();
  JournalSocket(const JournalSocket&) = delete;
  JournalSocket& operator=(const JournalSocket&) = delete;

  /// Keeps the order: no entry overtakes a kept one.
  void send(std::string entry, bool matters);
  /// Tries again what is kept. True when nothing is left.
  bool flush();
  /// How many entries were lost since the last call.
  std::uint64_t take_lost();

 private:
  enum class Result { taken, not_now, never };
  Result try_send(const std::string& entry) const;

  std::string path_;
  int socket_ = -1;
  std::deque<std::string> kept_;
  std::uint64_t lost_ = 0;
};

}  // namespace slamgw
