// SPDX-License-Identifier: Apache-2.0
// A pty in raw mode with a symbolic link to its slave side: the board's serial port. Owns both
// descriptors and the link.
#pragma once

#include <string>

namespace slamgw::sim::ble {

class PseudoTerminal {
 public:
  /// Replaces a symbolic link at `path`, never anything else. Throws std::system_error.
  explicit PseudoTerminal(std::string path);
  /// Removes the link if it is still this one.
  ~PseudoTerminal();
  PseudoTerminal(const PseudoTerminal&) = delete;
  PseudoTerminal& operator=(const PseudoTerminal&) = delete;

  /// The board's end, non-blocking.
  int master() const { return master_; }
  const std::string& slave_name() const { return slave_name_; }
  /// Returns the number of octets that the host has not read yet.
  int unread_octets() const;
  /// Undoes TIOCEXCL. The slave side stays open here, as the board's end would see only errors
  /// without a host. So the flag of an earlier host would lock out the next one.
  void allow_next_host();

 private:
  void open();
  void close();
  void make_link();

  std::string path_;
  std::string slave_name_;
  int master_ = -1;
  int slave_ = -1;
};

}  // namespace slamgw::sim::ble
