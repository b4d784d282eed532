// The Arduino IDE wants a sketch to have a file of its folder's name. setup() and loop() are in tepm.cpp; what a lab changes is in config.h.
