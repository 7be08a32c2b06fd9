// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/board_lives.hpp"

#include <fmt/format.h>

namespace slamgw::ble {

void BoardLives::on_board_empty(const std::string& board, bool was_cleared) {
  BoardLife& life = nodes_.ledger().change().life;
  const bool is_same = !board.empty() && life.board == board;
  if (!is_same) life.kind = BoardKind::unknown;
  if (is_same && life.number > 0 && !was_cleared) life.kind = BoardKind::forgets;
  life.board = board;
  begin_life(life);
  unanswered_ = life.number;
}

void BoardLives::begin_life(BoardLife& life) {
  const std::uint32_t end = settings_.address + nodes_.source_room();
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
  unanswered_.reset();
  actions_.push(UseSource{life()->source});
}

void BoardLives::on_board_up(const std::string& board, std::uint16_t source, bool has_kept) {
  source_ = source;
  if (life() == nullptr) return;
  BoardLife now = *life();
  if (now.board != board) now.kind = BoardKind::unknown;
  if (has_kept) now.kind = BoardKind::keeps;
  now.board = board;
  now.number = std::max(now.number, std::uint32_t{1});
  // A board that kept its address from a life which this file does not know.
  now.source = std::max(now.source, source);
  if (now != *life()) nodes_.ledger().change().life = now;
}

BoardKind BoardLives::kind() const { return life() ? life()->kind : BoardKind::unknown; }

bool BoardLives::is_reused() const { return number() > nodes_.source_room(); }

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
