// Runs a controller: reads a scale, whether velocities are references, then rows of q, v, effort references.
#include <iostream>
#include <string>

#include "controller_interface/chainable_controller_interface.hpp"

namespace ci = controller_interface;

std::unique_ptr<ci::ChainableControllerInterface> make_plugin();

int main() {
  auto controller = make_plugin();
  double scale = 0.0;
  bool desired = false;
  if (!(std::cin >> scale >> desired) || controller->on_init() != ci::CallbackReturn::SUCCESS) return 1;
  controller->get_node()->values["scale"] = scale;
  if (controller->on_configure({}) != ci::CallbackReturn::SUCCESS) return 2;
  auto references = controller->export_reference_interfaces();
  const auto states = controller->state_interface_configuration().names;
  const auto commands = controller->command_interface_configuration().names;
  const std::size_t count = commands.size();
  std::vector<double> state(states.size()), command(count);
  for (std::size_t i = 0; i < states.size(); ++i) {
    controller->state_interfaces_.emplace_back("", states[i], &state[i]);
  }
  for (std::size_t i = 0; i < count; ++i) controller->command_interfaces_.emplace_back("", commands[i], &command[i]);
  if (controller->on_activate({}) != ci::CallbackReturn::SUCCESS) return 3;
  for (const auto& name : commands) std::cout << name << ' ';
  for (const auto& reference : references) std::cout << reference.get_name() << ' ';
  std::cout << '\n';
  std::cout.precision(17);
  for (std::string word; std::cin >> word;) {
    for (std::size_t i = 0; i < 3 * count; ++i) {
      if (i > 0) std::cin >> word;
      const double value = std::stod(word);  // which reads "nan", too
      const std::size_t joint = i % count;
      bool kept = true;
      if (i < count) {
        state[2 * joint] = value;
      } else if (i < 2 * count) {
        state[2 * joint + 1] = desired ? 100.0 : value;
        if (desired) kept = references[2 * joint + 1].set_value(value);
      } else {
        kept = references[2 * joint].set_value(value);
      }
      if (!kept) return 4;
    }
    if (controller->update_and_write_commands({}, {0.25}) != ci::return_type::OK) {
      std::cout << "error\n";
      continue;
    }
    for (const double x : command) std::cout << x << ' ';
    std::cout << '\n';
  }
}
