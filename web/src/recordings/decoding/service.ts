/** The events of ROS 2 services, whose definition a recording carries as the text of the service itself.
 *
 * Source: design.ros2.org and REP 2012 (service introspection): `X_Event` holds `info`, at most one request and response.
 */

const RULE = /^=+[ \t]*$/m;
const PARTED = /^---[ \t]*$/m;
const INFO = `uint8 event_type
builtin_interfaces/Time stamp
uint8[16] client_gid
int64 sequence_number
`;

/** Return a definition that a parser of messages can follow; a text that is no service's stays as it is. */
export function withService(definition: string, name: string): string {
  const rule = RULE.exec(definition);
  const own = rule === null ? definition : definition.slice(0, rule.index);
  const others = rule === null ? "" : definition.slice(rule.index);
  const sections = own.split(PARTED);
  const [request, response] = sections;
  if (sections.length !== 2 || request === undefined || response === undefined) return definition;
  if (/_Request$/.test(name)) return `${request}\n${others}`;
  if (/_Response$/.test(name)) return `${response}\n${others}`;
  const base = name.replace(/_Event$/, "");
  const info = /^MSG: service_msgs\/(msg\/)?ServiceEventInfo\s*$/m.test(others) ? "" : block("service_msgs/msg/ServiceEventInfo", INFO);
  const event = `service_msgs/msg/ServiceEventInfo info\n${base}_Request[] request\n${base}_Response[] response\n`;
  return event + block(`${base}_Request`, request) + block(`${base}_Response`, response) + info + others;
}

function block(name: string, text: string): string {
  return `${"=".repeat(80)}\nMSG: ${name}\n${text}\n`;
}
