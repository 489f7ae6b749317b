#include "rtagent.h"

namespace rtagent {

namespace {

const uint8_t Analog = 0x80;  // marks analog pins in a hello
const uint32_t ShortestPeriod = 200;
const uint8_t AdcCycles = 14;  // of its own clock for a conversion; 13 and the wait for the next one to begin
const uint8_t ReadingCycles = 60;  // of the processor's, for what stands around a conversion
const uint8_t EncodingTime = 130, SendingTime = 16;  // µs for a frame of readings, and for each byte of it
const uint8_t FrameBytes = 11;                       // beside the readings

bool is_analog(uint8_t pin) { return pin >= A0; }

}  // namespace

void Board::start() {
  for (uint8_t i = 0; i < count_; i++) pinMode(channels_[i], is_analog(channels_[i]) ? INPUT : INPUT_PULLUP);
  servos_.begin(servo_pins_, servo_count_);
  configure(Settings());
  say_hello(true);
}

void Board::configure(const Settings &settings) {
  settings_ = settings;
  if (settings_.period < ShortestPeriod) settings_.period = ShortestPeriod;
  choose_adc_clock();
  due_ = micros() + settings_.period;
}

// The slowest clock of the converter, which is the most exact, that leaves time for everything else.
void Board::choose_adc_clock() {
  const uint32_t others = EncodingTime + SendingTime * (FrameBytes + 2 * count_);
  const uint32_t left = settings_.period / 10 * 9;
  const uint32_t cycles = left > others ? (left - others) * (F_CPU / 1000000) / count_ : 0;
  uint8_t prescaler = 7;  // the processor's clock by 2 to the power of this
  while (prescaler > 4 && (uint32_t(AdcCycles) << prescaler) + ReadingCycles > cycles) prescaler--;
  ADCSRA = (ADCSRA & ~7) | prescaler;
}

void Board::turn() {
  hear();
  watch_heartbeat();
  if (int32_t(micros() - due_) >= 0) scan();
}

void Board::hear() {
  while (Serial.available()) {
    if (receiver_.take(Serial.read())) obey(receiver_);
  }
}

void Board::obey(const Receiver &told) {
  heard_ = millis();
  if (told.type() == Ask) say_hello(false);
  if (told.type() == Arm) safety_ = Moving;
  if (told.type() == Pulses) move(told);
  if (told.type() == MakeSafe) make_safe(ToldTo);
  if (told.type() == Configure && told.size() == 7) {
    Settings settings;
    settings.period = told.get32(0);
    settings.heartbeat = told.get16(4);
    settings.stop = told.get8(6);
    configure(settings);
    say_hello(false);
  }
}

void Board::move(const Receiver &told) {
  if (told.size() != 2 * servo_count_) return;
  if (safety_ != Moving) return say_state();
  for (uint8_t i = 0; i < servo_count_; i++) {
    uint16_t width = told.get16(2 * i);
    if (width != Servos::Unchanged) servos_.pulse(i, width);
  }
}

void Board::make_safe(Safety why) {
  if (settings_.stop == Detach) servos_.detach();
  safety_ = why;
  say_state();
}

void Board::watch_heartbeat() {
  if (safety_ == Moving && millis() - heard_ > settings_.heartbeat) make_safe(Unheard);
}

// Puts the time in the middle of the scan and all readings into a frame, which is closed; returns that time.
uint32_t Board::measure_all(Frame &frame) const {
  uint16_t values[MostChannels];
  const uint32_t began = micros();
  for (uint8_t i = 0; i < count_; i++) values[i] = measure(i);
  const uint32_t middle = began + (micros() - began) / 2;
  frame.put32(middle);
  for (uint8_t i = 0; i < count_; i++) frame.put16(values[i]);
  frame.close();
  return middle;
}

void Board::scan() {
  Frame frame(Scan);
  frame.put16(number_++);
  measure_all(frame);
  frame.send(Serial);
  due_ += settings_.period;
  if (int32_t(micros() - due_) > int32_t(settings_.period)) due_ = micros();  // what was missed is not made up for
}

uint16_t Board::measure(uint8_t channel) const {
  const uint8_t pin = channels_[channel];
  return is_analog(pin) ? analogRead(pin) : digitalRead(pin);
}

// Tells also how long a scan takes, sending included, and how long after its time a frame is ready to be sent.
void Board::say_hello(bool started) {
  const uint32_t began = micros();
  Frame trial(Scan);
  trial.put16(0);
  const uint32_t middle = measure_all(trial);
  const uint32_t ended = micros();
  Frame frame(Hello);
  frame.put8(Version);
  frame.put8(started);
  frame.put32(settings_.period);
  frame.put16(ended - began + SendingTime * (FrameBytes + 2 * count_));
  frame.put16(ended - middle);
  frame.put16(settings_.heartbeat);
  frame.put8(settings_.stop);
  frame.put8(count_);
  for (uint8_t i = 0; i < count_; i++) {
    frame.put8(is_analog(channels_[i]) ? Analog | (channels_[i] - A0) : channels_[i]);
  }
  frame.put8(servo_count_);
  for (uint8_t i = 0; i < servo_count_; i++) frame.put8(servo_pins_[i]);
  frame.close();
  frame.send(Serial);
}

void Board::say_state() {
  Frame frame(ServoState);
  frame.put8(safety_);
  frame.put16(receiver_.bad());
  for (uint8_t i = 0; i < servo_count_; i++) frame.put16(servos_.width(i));
  frame.close();
  frame.send(Serial);
}

}  // namespace rtagent
