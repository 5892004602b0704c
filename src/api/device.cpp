#include "api/device.hpp"

#include <algorithm>
#include <cstdlib>
#include <map>
#include <mutex>

#include "backends/open.hpp"

namespace globule {
namespace {

Chosen cpu() {
    const std::vector<std::string> levels = core::cpu_backends();
    if (levels.empty())
        throw Error(ErrorCode::device,
            "no CPU backend runs here: the processor is older than x86-64-v2, or libglobule_cpu_*.so are missing");
    std::string name = levels.back();
    if (const char* wanted = std::getenv("GLOBULE_SIMD")) {
        name = std::string("cpu_") + wanted;
        if (std::find(levels.begin(), levels.end(), name) == levels.end()) {
            std::string all;
            for (const std::string& level : levels) all += (all.empty() ? "" : ", ") + level.substr(4);
            throw Error(ErrorCode::invalid, "GLOBULE_SIMD: expected one of " + all + ", got " + wanted);
        }
    }
    const core::BackendApi& backend = core::open_backend(name);
    bool ok = false;
    std::string description = core::describe(backend, 0, ok);
    return {&backend, 0, {"cpu", std::move(description), ""}};
}

Chosen cuda(int index) {
    const core::BackendApi& backend = core::open_backend("cuda");
    static std::mutex mutex;
    static std::map<int, std::string>
        known;  // the driver takes its time to say what a device is; an error is asked for again
    const std::lock_guard lock(mutex);
    auto found = known.find(index);
    if (found == known.end()) {
        bool ok = false;
        std::string description = core::describe(backend, index, ok);
        if (!ok) throw Error(ErrorCode::device, description);
        found = known.emplace(index, std::move(description)).first;
    }
    return {&backend, index, {"cuda:" + std::to_string(index), found->second, ""}};
}

}  // namespace

Chosen choose(const std::string& device) {
    core::check_not_forked();
    if (device == "cpu") return cpu();
    if (device == "cuda") return cuda(0);
    if (device.starts_with("cuda:")) {
        const std::string digits = device.substr(5);
        if (!digits.empty() && digits.size() <= 4 && digits.find_first_not_of("0123456789") == std::string::npos)
            return cuda(std::stoi(digits));
    }
    if (device != "auto")
        throw Error(ErrorCode::invalid, "device: expected auto, cpu, cuda or cuda:N, got \"" + device + "\"");
    try {
        return cuda(0);
    } catch (const Error& e) {
        Chosen chosen = cpu();
        chosen.device.note = e.what();
        return chosen;
    }
}

Device find_device(const std::string& device) { return choose(device).device; }

std::vector<Device> devices() {
    std::vector<Device> found{cpu().device};
    try {
        for (int index = 0;; ++index) found.push_back(cuda(index).device);
    } catch (const Error& e) {
        if (e.code() == ErrorCode::forked) throw;
    }
    return found;
}

}  // namespace globule
