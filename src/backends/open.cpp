#include "backends/open.hpp"

#include <dlfcn.h>

#include <filesystem>
#include <map>
#include <mutex>
#include <string_view>

#include "globule/error.hpp"

namespace globule::core {
namespace {

std::filesystem::path folder() {
    Dl_info info;
    dladdr(reinterpret_cast<void*>(&folder), &info);
    return std::filesystem::path(info.dli_fname).parent_path();
}
/// Beside this library, as in a Python package, or in a folder of their own.
std::filesystem::path file_of(const std::string& name) {
    const std::string file = "libglobule_" + name + ".so";
    const std::filesystem::path beside = folder() / file;
    return std::filesystem::exists(beside) ? beside : folder() / "globule" / file;
}

bool runs_here(const std::string& level) {
#if defined(__x86_64__)
    if (level == "cpu_v4") return __builtin_cpu_supports("x86-64-v4");
    if (level == "cpu_v3") return __builtin_cpu_supports("x86-64-v3");
    return __builtin_cpu_supports("x86-64-v2");
#else
    return level == "cpu_v2";  // the plain build
#endif
}

}  // namespace

std::vector<std::string> cpu_backends() {
    std::vector<std::string> found;
    for (const char* name : {"cpu_v2", "cpu_v3", "cpu_v4"})
        if (runs_here(name) && std::filesystem::exists(file_of(name))) found.push_back(name);
    return found;
}

const BackendApi& open_backend(const std::string& name) {
    static std::mutex mutex;
    static std::map<std::string, const BackendApi*> open;
    const std::lock_guard lock(mutex);
    if (auto it = open.find(name); it != open.end()) return *it->second;
    const std::filesystem::path path = file_of(name);
    if (!std::filesystem::exists(path))
        throw Error(ErrorCode::device, "this build has no " + name + " backend (" + path.filename().string() + ")");
    void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (!library) throw Error(ErrorCode::device, "cannot load the " + name + " backend: " + dlerror());
    const auto* interface = static_cast<const char*>(dlsym(library, "globule_interface"));
    const auto* api = static_cast<const BackendApi*>(dlsym(library, "globule_backend"));
    if (!interface || !api || std::string_view(interface) != GLOBULE_INTERFACE)
        throw Error(ErrorCode::device, "the " + name + " backend library is of another version (interface " +
                                           (interface ? interface : "not named") +
                                           ", expected " GLOBULE_INTERFACE "): install globule again");
    return *(open[name] = api);
}

}  // namespace globule::core
