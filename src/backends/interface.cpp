// What a backend library calls itself, so that only libraries that were built from the same headers call each other.
extern "C" __attribute__((visibility("default"))) const char globule_interface[] = GLOBULE_INTERFACE;
