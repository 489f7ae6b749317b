// The glove: six bend sensors on A0 to A5, on an Uno or a Leonardo.
#include <rtagent.h>

const uint8_t channels[] = {A0, A1, A2, A3, A4, A5};
rtagent::Board board(channels);

void setup() { board.begin<1000000>(); }

void loop() { board.turn(); }
