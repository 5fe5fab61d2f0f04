// Makes the plugin as pluginlib would.
#pragma once

#include <memory>

#define PLUGINLIB_EXPORT_CLASS(plugin, base) \
  std::unique_ptr<base> make_plugin() { return std::make_unique<plugin>(); }
