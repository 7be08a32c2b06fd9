// SPDX-License-Identifier: Apache-2.0
// The common part of the BLE mesh's shells, for any link to a radio: the machine, its driver, and a
// problem that keeps the mesh off. Loop's thread only.
#pragma once

#include <boost/asio/io_context.hpp>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "daemon/core/robot_names.hpp"
#include "daemon/runtime/mesh_shell.hpp"

namespace slamgw::ble {

template <MeshProtocolMachine Machine>
class BleShell : public MeshShell<Machine> {
 public:
  void start() override {
    is_stopped_ = false;
    if (!problem_.empty()) {
      notify(Severity::error, problem_);
      listener_.on_mesh_event(LinkChange{Mesh::ble, false, problem_});
      return;
    }
    driver_->on_start();
    open();
  }
  void stop() override {
    is_stopped_ = true;
    driver_.stop();
    close();
  }
  std::vector<WaitingMessage> give_up(const std::string& robot) override {
    return driver_->give_up(robot, read_clocks());
  }

  /// Takes `robots` of the configuration, read again. Robots stay in the mesh.
  void reconfigure(RobotNames names) {
    if (is_stopped_ || !problem_.empty()) return;
    driver_->on_names(std::move(names), read_clocks());
  }

 protected:
  using MachineAction = ActionOf<Machine>;

  struct Made {
    std::unique_ptr<Machine> machine;
    std::string problem = {};  ///< why the mesh stays off; else empty
  };

  /// `listener` must outlive the shell.
  BleShell(boost::asio::io_context& io, Made made, MeshListener& listener)
      : problem_(std::move(made.problem)),
        listener_(listener),
        machine_(std::move(made.machine)),
        driver_(
            io, *machine_,
            [this](MachineAction& action) {
              if (!is_stopped_) perform(action);
            },
            [this] { on_drained(); }) {}

  /// Opens the link to the radio, and keeps it open from then on.
  virtual void open() = 0;
  virtual void close() = 0;
  /// Does one action of the machine; not called after stop().
  virtual void perform(MachineAction& action) = 0;
  /// The machine's actions are done.
  virtual void on_drained() {}

  bool is_stopped() const { return is_stopped_; }
  const std::string& problem() const { return problem_; }
  MeshListener& listener() { return listener_; }
  void notify(Severity severity, std::string text) {
    listener_.on_mesh_event(Notice{severity, std::move(text), {}});
  }
  const Machine& machine() const { return *machine_; }
  MachineDriver<Machine>& driver() override { return driver_; }
  const MachineDriver<Machine>& driver() const override { return driver_; }

 private:
  std::string problem_;
  MeshListener& listener_;
  std::unique_ptr<Machine> machine_;
  MachineDriver<Machine> driver_;
  bool is_stopped_ = true;
};

}  // namespace slamgw::ble
