// A node of an aedes cluster, which stores and forwards all messages over Redis: node.mjs PORT REDIS_PORT NAME
import { createServer } from 'node:net'
import { Aedes } from 'aedes'
import redisPersistence from 'aedes-persistence-redis'
import redisEmitter from 'mqemitter-redis'

const [port, redis, name] = process.argv.slice(2)
// without a limit of attempts, so that a node that cannot reach Redis waits for it and does not end
const connection = { host: '127.0.0.1', port: Number(redis), enableReadyCheck: false, maxRetriesPerRequest: null }

/** Time after which a message of a disconnected client no longer delays others, ms. */
const TURN_MAX = 1000

// aedes numbers messages on arrival, and drops a message with a lower number than the last one as a repetition. A
// retained message is stored before it is forwarded, so a message that is not retained would overtake it. Therefore
// messages are forwarded one at a time.
let last = Promise.resolve()
let end = () => {}
const inTurn = (client, packet, done) => {
  const before = last
  last = before.then(() => new Promise((resolve) => {
    end = resolve
    setTimeout(resolve, TURN_MAX)
    done(null)
  }))
}

const emitter = redisEmitter(connection)
emitter.state.on('error', (error) => console.error(`Redis: ${error.message}`))

const broker = await Aedes.createBroker({
  // a new id at each start: otherwise the messages of a restarted node, whose counter starts again, would be
  // treated as repetitions
  id: `${name}-${Date.now()}`,
  persistence: redisPersistence(connection),
  mq: emitter,
  authorizePublish: inTurn,
  published: (packet, client, done) => {
    if (client) end()
    done()
  },
})
createServer((socket) => {
  socket.setNoDelay(true)
  broker.handle(socket)
}).listen(Number(port), '127.0.0.1', () => console.log('listens'))
