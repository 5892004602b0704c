// A backend library of another version: all that may be asked of it is its name.
extern "C" __attribute__((visibility("default"))) const char globule_interface[] = "1";
