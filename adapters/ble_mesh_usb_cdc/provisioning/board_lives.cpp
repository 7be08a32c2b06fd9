// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/board_lives.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace slamgw::ble {

void BoardLives::on_source_wanted(const SourceWanted& wanted) {
  BoardLife now = *life();
  const bool is_empty = wanted.addresses == 0;
  const bool is_other = !now.board.empty() && now.board != wanted.board;
  if (is_other) now.kind = BoardKind::unknown;
  if (is_empty && !is_other && !now.board.empty() && !wanted.was_cleared)
    now.kind = BoardKind::forgets;
  now.board = wanted.board;
  const std::uint32_t room = nodes_.source_room();
  if ((is_empty || is_other) && unused_ != now.number) {
    begin_life(now, settings_.address +
                        (is_empty ? room : std::min<std::uint32_t>(room, wanted.addresses)));
    unused_ = now.number;
  }
  if (now != *life()) nodes_.ledger().change().life = now;
  unanswered_ = wanted.addresses;
  if (unused_ != now.number || nodes_.ledger().is_saved()) answer();
}

void BoardLives::answer() {
  const std::uint16_t addresses = *std::exchange(unanswered_, std::nullopt);
  const std::uint16_t count = addresses > 0 ? addresses : nodes_.source_room();
  const int last = settings_.address + count - 1;
  const int source = std::clamp<int>(life()->source, settings_.address, last);
  actions_.push(UseSource{static_cast<std::uint16_t>(source), count});
}

void BoardLives::begin_life(BoardLife& life, std::uint32_t end) {
  const std::uint16_t last = life.source == 0 ? settings_.address : life.source;
  const bool had_address = life.number > 0 && last >= settings_.address;
  life.source =
      had_address && last + 1U < end ? static_cast<std::uint16_t>(last + 1) : settings_.address;
  ++life.number;
  if (!had_address || life.source != settings_.address) return;
  actions_.push(Notice{
      Severity::warning,
      fmt::format("the addresses for the serial board's lives are used up after life {}: the "
                  "gateway sends from 0x{:04x} again, which robots may ignore; switch robots that "
                  "do not obey off and on",
                  life.number - 1, life.source),
      {}});
}

void BoardLives::on_stored(const std::string& problem) {
  if (!unanswered_) return;
  if (!problem.empty()) {
    actions_.push(DelaySource{problem});
    return;
  }
  if (!nodes_.ledger().is_saved()) return;
  answer();
}

void BoardLives::on_board_up(const LinkIsUp& up) {
  source_ = up.source;
  unused_.reset();
  if (life() == nullptr) return;
  BoardLife now = *life();
  if (now.board != up.board) now.kind = BoardKind::unknown;
  if (up.has_kept) now.kind = BoardKind::keeps;
  now.board = up.board;
  now.number = std::max(now.number, std::uint32_t{1});
  // A board that kept its address from a life which this file does not know.
  now.source = std::max(now.source, up.source);
  if (now != *life()) nodes_.ledger().change().life = now;
}

BoardKind BoardLives::kind() const { return life() ? life()->kind : BoardKind::unknown; }

bool BoardLives::is_reused() const { return life() && number() > nodes_.source_room(); }

std::string BoardLives::description() const {
  std::string text = fmt::format("sends from 0x{:04x}", source_);
  if (number() > 0) text += fmt::format(" (life {})", number());
  switch (kind()) {
    case BoardKind::unknown: return text;
    case BoardKind::forgets: return "forgets at power-off, " + text;
    case BoardKind::keeps: return "keeps its address at power-off, " + text;
  }
  return text;
}

}  // namespace slamgw::ble
